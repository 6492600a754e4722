// The live socket of the vehicle shown before, opened while the page's program is still on its way: its newest state
// is here when the program starts, and the operator's sign of life goes on over a reload (model/liveness.rs answers
// from then on). A file of its own, because the ground's content security policy lets no inline script run.
(() => {
  // A program that never starts is no sign of an operator.
  const PATIENCE_MS = 20_000;
  const MOST_BYTES = 8 << 20;
  const STATUS = 30, CHALLENGE = 25, HEADER = 24;

  // Who this page is towards the ground: the operator's name, and what tells this tab from others. As long as the tab.
  let vehicle = '', operator = '';
  try {
    vehicle = localStorage.getItem('plumbline.vehicle') ?? '';
    operator = sessionStorage.getItem('plumbline.operator') ?? '';
    if (!operator) {
      const tab = crypto.getRandomValues(new Uint16Array(1))[0].toString(16).padStart(4, '0');
      operator = `${localStorage.getItem('plumbline.name') || 'Operator'} ${tab}`;
      sessionStorage.setItem('plumbline.operator', operator);
    }
  } catch (e) {
    // Without storage every reload is another operator.
    operator ||= `Operator ${Math.random().toString(16).slice(2, 6)}`;
  }
  const early = globalThis.plumblineEarly = { operator };

  // The varint of one field of a protobuf message, as it stands there: bytes from `at` to `end`.
  const varint = (bytes, at, end, wanted) => {
    const read = () => {
      let value = 0, shift = 1, byte;
      do {
        byte = bytes[at++];
        value += (byte & 127) * shift;
        shift *= 128;
      } while (byte & 128 && at < end);
      return value;
    };
    while (at < end) {
      const key = read(), begin = at;
      switch (key % 8) {
        case 0: read(); if (key === wanted * 8) return bytes.subarray(begin, at); break;
        case 1: at += 8; break;
        case 2: { const length = read(); at += length; break; }
        case 5: at += 4; break;
        default: return undefined;
      }
    }
    return undefined;
  };

  // The newest challenge of a batch, see proto/src/codec.rs.
  const challenge = (buffer) => {
    const bytes = new Uint8Array(buffer), view = new DataView(buffer);
    let found;
    for (let at = 2; at + HEADER <= bytes.length;) {
      const end = at + HEADER + view.getUint32(at + 4, true);
      if (view.getUint16(at, true) === STATUS && end <= bytes.length) found = varint(bytes, at + HEADER, end, CHALLENGE) ?? found;
      at = end;
    }
    return found;
  };

  const open = (vehicle) => {
    // The program was faster, and has opened one of its own.
    if (globalThis.plumblineEarly !== early) return;
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    const query = `thinned=true&operator=${encodeURIComponent(operator)}`;
    const socket = new WebSocket(`${scheme}://${location.host}/api/v1/vehicles/${encodeURIComponent(vehicle)}/live?${query}`);
    socket.binaryType = 'arraybuffer';
    const begun = performance.now();
    let batches = [], bytes = 0;
    socket.onmessage = ({ data }) => {
      batches.push(data);
      bytes += data.byteLength;
      // The first ones are the newest of every topic; after them the oldest go first.
      while (bytes > MOST_BYTES && batches.length > 3) bytes -= batches.splice(2, 1)[0].byteLength;
      const answer = challenge(data);
      if (answer && performance.now() - begun < PATIENCE_MS) socket.send(Uint8Array.of(8, ...answer));
    };
    Object.assign(early, {
      vehicle, socket,
      take() {
        socket.onmessage = null;
        return batches;
      },
    });
  };
  if (vehicle) open(vehicle);
  else {
    // The first visit: the vehicle that the page would choose, see app.rs.
    fetch('/api/v1/vehicles').then((answer) => (answer.ok ? answer.json() : [])).then((all) => {
      const first = all.find((each) => each.connected) ?? all[0];
      if (first) open(first.id);
    }).catch(() => {});
  }
})();
