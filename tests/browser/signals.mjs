// What lies in a recording: small pictures in the list, any signal on a chart of its own, spectra; curves shown alone,
// tones, and a gamepad.

import { asks, assert, complaints, drawn, end, holdUntil, launch, number, pilot, shot, shots, step, steppedWith, until, url } from './support.mjs';

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
const page = await context.newPage();
page.setDefaultTimeout(20_000);
const errors = complaints(page);
const { region, button, banner, arm, to, disarm } = pilot(page);
const listed = async () => (await (await page.request.get(`${url}/api/v1/flights`)).json()).flights;
// A gamepad that the scripts press: two sticks, and the right shoulder button.
await page.addInitScript(() => {
  globalThis.pad = { connected: false, id: 'Test pad', axes: [0, 0, 0, 0], pressed: false };
  const button = (pressed) => Object.create(GamepadButton.prototype, { pressed: { value: pressed } });
  navigator.getGamepads = () => {
    const { connected, id, axes, pressed } = globalThis.pad;
    if (!connected) return [null];
    const value = (value) => ({ value, enumerable: true });
    const buttons = Array.from({ length: 16 }, (_, i) => button(i === 5 && pressed));
    return [Object.create(Gamepad.prototype, { connected: value(true), id: value(id), axes: value(axes), buttons: value(buttons) })];
  };
  globalThis.notes = [];
  const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function note(...when) {
    globalThis.notes.push(Math.round(this.frequency.value));
    return start.apply(this, when);
  };
});

await step(page, 'legend: one curve alone, then all again', async () => {
  await page.goto(url);
  const legend = region('Attitude chart').getByRole('list').first();
  const shown = async () => {
    const found = {};
    for (const name of ['roll', 'pitch', 'yaw']) found[name] = await legend.getByRole('button', { name, exact: true }).getAttribute('aria-pressed');
    return Object.entries(found).filter(([, on]) => on === 'true').map(([name]) => name).join();
  };
  await until('three curves', async () => (await shown()) === 'roll,pitch,yaw');
  await legend.getByRole('button', { name: 'pitch', exact: true }).click({ modifiers: ['Alt'] });
  await until('pitch alone', async () => (await shown()) === 'pitch');
  await legend.getByRole('button', { name: 'pitch', exact: true }).dblclick();
  await until('all again', async () => (await shown()) === 'roll,pitch,yaw');
  await legend.getByRole('button', { name: 'yaw', exact: true }).click();
  await until('two', async () => (await shown()) === 'roll,pitch');
  await legend.getByRole('button', { name: 'yaw', exact: true }).click();
});

await step(page, 'tones: heard, switched off by a key, and kept so', async () => {
  await page.goto(`${url}/setup`);
  await button('Hear one').click();
  // Another tune may sound beside it, where what is shown is old for a moment.
  await until('the notes of a failsafe, once', async () => (await page.evaluate(() => globalThis.notes.join())).match(/988,740,988,740/g)?.length === 1);
  await page.keyboard.press('t');
  await until('them to be off', async () => button('Hear one').isDisabled());
  await page.reload();
  assert(await button('Hear one').isDisabled(), 'a reload switched them on');
  await page.getByRole('checkbox', { name: 'on (T)' }).check();
  await until('them to be on', async () => !(await button('Hear one').isDisabled()));
});

const signals = region('Signals');
const search = signals.getByRole('searchbox', { name: 'Search the signals' });
const charted = () => signals.getByRole('group').evaluateAll((all) => all.map((e) => e.getAttribute('aria-label')));
/** Takes the one signal that all of these words name off the list, and lets it go over the charts. */
const dragged = async (words) => {
  await search.fill(words);
  const item = signals.getByRole('listitem').first();
  await item.waitFor();
  const box = await item.boundingBox();
  await page.mouse.move(box.x + 20, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + 40, box.y + box.height / 2 + 5, { steps: 3 });
  const zone = signals.getByText('Drop it here: a plot of its own');
  await zone.waitFor();
  const place = await zone.boundingBox();
  await page.mouse.move(place.x + place.width / 2, place.y + place.height / 2, { steps: 4 });
  await page.mouse.up();
  await zone.waitFor({ state: 'detached' });
};

await step(page, 'signals, live: what no page is sent otherwise comes onto a plot, dragged there or by the keyboard', async () => {
  await page.goto(url);
  await region('Residuals').getByRole('button', { name: 'Signals' }).click();
  await dragged('imu_1.sensed.gyro_radps.y');
  await until('its plot', async () => (await charted()).join() === 'imu_1.sensed.gyro_radps.y');
  await search.fill('status tick_time_p99');
  await search.press('Enter');
  await until('two plots', async () => (await charted()).length === 2);
  for (const one of await signals.getByRole('img').all()) await drawn(page, one, await one.getAttribute('aria-label'));
  // What came before it was asked for is there too, and it goes on.
  const value = signals.locator('.signal-value b').first();
  const values = new Set();
  await until('values that change', async () => values.add(await value.textContent()).size >= 4);
  await shots(page, 'fly-signals');
  const [name] = await charted();
  await signals.getByRole('group', { name, exact: true }).getByRole('button', { name: 'Spectrum' }).click();
  const told = signals.locator('.density > p').first();
  await until('its spectrum', async () => /^RMS [\d.]+ rad\/s; peak [\d.]+ Hz; in view, mean of \d+ windows/.test(await told.textContent()));
  await until('the address', async () => decodeURIComponent(page.url()).includes('?signals=~imu_1.sensed.gyro_radps.y,status.tick_time_p99_us'));
  return { told: await told.textContent() };
});

await step(page, 'layouts: kept under a name, taken back, and the same after a reload', async () => {
  const bar = page.getByRole('dialog', { name: 'Layouts' });
  const rows = bar.getByRole('listitem');
  // By the keyboard.
  await button('Layout').focus();
  await page.keyboard.press('Enter');
  await bar.getByLabel('Name for this layout').fill(' rates ');
  await page.keyboard.press('Enter');
  await until('its name', async () => (await rows.allTextContents()).some((text) => text.startsWith('rates')));
  const link = await bar.getByLabel('Address, to share').inputValue();
  assert(link === page.url(), `${link} is not ${page.url()}`);
  await shot(page, 'fly-layouts-light-1280x720');
  await rows.getByRole('button', { name: 'default' }).click();
  await region('Residuals').waitFor();
  await until('an address without it', async () => !page.url().includes('signals='));
  await page.getByLabel('Time window').selectOption('60');
  await button('Layout').click();
  await rows.getByRole('button', { name: 'rates', exact: true }).click();
  await until('both plots', async () => (await charted()).length === 2);
  assert((await page.getByLabel('Time window').inputValue()) === '30', 'its window');
  await page.reload();
  await until('both plots after a reload', async () => (await charted()).join() === 'imu_1.sensed.gyro_radps.y,status.tick_time_p99_us');
  await until('its spectrum', async () => /peak/.test(await signals.locator('.density > p').first().textContent()));
  // Opened before anything has come from the vehicle: of nothing there is no spectrum to ask for.
  const early = await context.newPage();
  const asked = [];
  early.on('request', (request) => request.url().includes('/spectrum?') && asked.push(request.url()));
  let kept = [];
  await early.routeWebSocket(/\/live/, (socket) => {
    const ground = socket.connectToServer();
    ground.onMessage((message) => (kept ? kept.push([socket, message]) : socket.send(message)));
  });
  await early.goto(page.url());
  const density = early.locator('.density > p').first();
  await density.waitFor({ state: 'attached' });
  await until('messages that wait', async () => kept.length > 20);
  assert(asked.length === 0, `asked for ${asked}`);
  for (const [socket, message] of kept) socket.send(message);
  kept = undefined;
  await until('its spectrum there', async () => /peak/.test(await density.textContent()));
  assert(asked.every((one) => number(new URL(one).searchParams.get('to_s')) > 0), `${asked}`);
  await early.close();
  await button('Layout').click();
  await bar.getByRole('button', { name: 'Forget the layout rates' }).click();
  await until('it to be forgotten', async () => (await rows.count()) === 1);
  await rows.getByRole('button', { name: 'default' }).click();
  await region('Residuals').waitFor();
});

await step(page, 'gamepad: flies while its button is held, and holds the altitude when it is let go', async () => {
  await page.goto(url);
  // Whatever flew before may still swing.
  await holdUntil('the reset', button('Reset (hold)'), async () => (await page.getByText(/^Reset the simulation: /).count()) > 0);
  await arm();
  await to(0.8);
  const card = region('Gamepad');
  assert(!(await card.count()), 'a card without a gamepad');
  await page.evaluate(() => { globalThis.pad.connected = true; });
  await card.getByText('Choose Stabilise').waitFor();
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: /stabilise/i }).click();
  await until('stabilise', async () => /stabilise/i.test(await banner.getByLabel('Mode').textContent()));
  await page.evaluate(() => Object.assign(globalThis.pad, { pressed: true, axes: [0, 0, 0.8, 0] }));
  const told = await until('a tilt', async () => {
    const text = await card.textContent();
    return /Flies iris-1/.test(text) && number(/roll ([^,]*)/.exec(text)?.[1]) >= 5 && text;
  });
  await shot(page, 'fly-gamepad-light-1280x720');
  const roll = async () => number(await region('Readouts').getByRole('definition').first().textContent());
  // A vehicle that cannot hold its altitude is asked to be level.
  await page.route('**/vehicles/*/mode', (route) => route.fulfill({ status: 409, json: { code: 'refused', detail: 'not now' } }));
  await page.evaluate(() => { globalThis.pad.pressed = false; });
  await page.getByText(/^Sticks let go: level: /).first().waitFor();
  await until('level, in stabilise', async () => Math.abs(await roll()) < 2 && /stabilise/i.test(await banner.getByLabel('Mode').textContent()));
  await page.unroute('**/vehicles/*/mode');
  await page.evaluate(() => { globalThis.pad.pressed = true; });
  await until('a tilt again', async () => (await roll()) > 3);
  // Where sticks get no answer the release waits for none of them, and what of them arrives after it changes nothing.
  let held;
  const holding = new Promise((resolve) => { held = resolve; });
  const late = [];
  await page.route('**/vehicles/*/setpoint', async (route) => {
    late.push(route.request());
    await holding;
    // What the page gave up has no answer to wait for.
    await route.continue().catch(() => {});
  });
  await until('sticks without an answer', async () => late.length > 0);
  await page.evaluate(() => { globalThis.pad.pressed = false; });
  await until('altitude hold', async () => /altitude hold/i.test(await banner.getByLabel('Mode').textContent()));
  held();
  await until('level, in altitude hold', async () => Math.abs(await roll()) < 2);
  await page.unroute('**/vehicles/*/setpoint');
  assert(/altitude hold/i.test(await banner.getByLabel('Mode').textContent()), 'sticks that came late left the mode');
  await page.evaluate(() => { globalThis.pad.connected = false; });
  await until('the card to go', async () => !(await card.count()));
  await Promise.all(late.map((request) => request.response().catch(() => null)));
  await page.waitForTimeout(1500);
  // A browser complains of each refusal: of the mode, and of sticks that came late.
  const refusals = errors.splice(0).filter((text) => !/status of 409.*\/(mode|setpoint)$/.test(text));
  assert(!refusals.length, refusals.join('\n'));
  return { told };
});

let flight;
await step(page, 'flights: each has a small picture of its altitude, with its attacks', async () => {
  const attack = page.getByRole('form', { name: 'New attack' });
  await attack.getByLabel('sensor').selectOption({ label: 'height 2' });
  await attack.getByLabel('kind').selectOption({ label: 'bias' });
  await attack.getByLabel(/^magnitude/).fill('0.5');
  await attack.getByLabel(/^start/).fill('1');
  // Long enough that the flight's signals come thinned: 15 s and more.
  await attack.getByLabel(/^duration/).fill('10');
  await attack.getByRole('button', { name: 'Add' }).click();
  await button('Schedule 1 attack').click();
  // Until then the first of the list may be an attack of before, done.
  for (const state of ['active', 'done']) {
    await until(`the attack: ${state}`, async () => (await region('Attacks').getByRole('listitem').first().textContent()).includes(state), 30_000);
  }
  await disarm();
  flight = await until('the flight to be complete', async () => {
    const [newest] = await listed();
    return newest?.completeness === 'complete' && newest.attacks.length > 0 && newest;
  });
  const known = flight.outline.altitude_cm.filter(Boolean);
  assert(known.length >= 16 && known.length <= 64 && Math.max(...known.flat()) > 60, JSON.stringify(flight.outline));
  await page.goto(`${url}/flights`);
  const picture = page.getByRole('img', { name: /Altitude .* to .* m, attacked/ }).first();
  await picture.waitFor();
  const box = await picture.boundingBox();
  const band = await picture.locator('rect').first().boundingBox();
  const planned = flight.attacks[0];
  const share = planned.duration_s / flight.duration_s;
  assert(Math.abs(band.width / box.width - share) < 0.02, `the attack takes ${band.width} of ${box.width} px, not ${share}`);
  await shots(page, 'flights');
  await page.setViewportSize({ width: 390, height: 844 });
  await shots(page, 'flights', '390x844');
  await page.setViewportSize({ width: 1280, height: 720 });
  return { stretches: known.length };
});

await step(page, 'flights: recordings of others are chosen or dropped, and each says what became of it', async () => {
  // Twenty seconds of a vehicle at rest, as BROAD writes it.
  const head = 't_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,ref_qz,ref_px_m,ref_py_m,ref_pz_m,movement';
  const rows = Array.from({ length: 2000 }, (_, i) => `${i / 100},0,0,0,0,0,9.81,0,20,-40,1,0,0,0,0,0,${0.5 + 0.1 * Math.sin(i / 200)},1`);
  const rest = { name: 'at rest.csv', mimeType: 'text/csv', buffer: Buffer.from([head, ...rows, ''].join('\n')) };
  const notes = { name: 'notes.txt', mimeType: 'text/plain', buffer: Buffer.from('hello') };
  await page.getByLabel('Recordings to import').setInputFiles([rest, notes]);
  const row = (name) => region('Imports').getByRole('listitem').filter({ hasText: name });
  await row('at rest.csv').getByRole('link', { name: 'open the flight' }).waitFor();
  await until('what is no recording is refused', async () => /^notes.txt ?a file that begins with "hello"; supported are/.test(await row('notes.txt').textContent()));
  await shots(page, 'imports');
  // Held over the list and let go; it is here already.
  const held = await page.evaluateHandle((text) => {
    const held = new DataTransfer();
    held.items.add(new File([text], 'copy.csv', { type: 'text/csv' }));
    return held;
  }, rest.buffer.toString());
  await page.dispatchEvent('#main', 'dragover', { dataTransfer: held });
  await until('the list says that it takes it', () => page.evaluate(() => document.querySelector('#main').classList.contains('dropped-on')));
  await page.dispatchEvent('#main', 'drop', { dataTransfer: held });
  await until('known', async () => /was here already/.test(await row('copy.csv').textContent()));
  await row('at rest.csv').getByRole('link', { name: 'open the flight' }).click();
  const title = page.getByLabel('Name of the flight');
  await until('its page', async () => (await title.inputValue()) === 'at rest.csv');
  await drawn(page, region('Altitude chart').getByRole('img').first(), 'its altitude');
  await shots(page, 'imported');
  const imported = await page.evaluate(() => location.pathname.split('/').pop());
  assert((await page.request.delete(`${url}/api/v1/flights/${imported}`, { headers: { Origin: url } })).status() === 204, imported);
  await page.goto(`${url}/flights`);
  return { imported };
});

await step(page, 'signals: any number that was recorded, found by a part of its name, on a chart of its own', async () => {
  await page.goto(`${url}/flights/${flight.id}`);
  await page.getByRole('slider', { name: /Position in the flight/ }).waitFor();
  await button('Signals').click();
  // Only the estimator in the loop was recorded in every tick.
  const often = Object.keys(flight.counts).filter((topic) => topic.startsWith('/estimate/')).sort((a, b) => flight.counts[b] - flight.counts[a]);
  const estimate = often[0].slice(1).replace('/', '_');
  await search.fill(`${estimate} body_rates x`);
  await signals.getByRole('listitem').first().waitFor();
  const offered = await signals.getByRole('listitem').allTextContents();
  assert(offered.join() === `${estimate}.body_rates_radps.x rad/s`, offered.join());
  await search.fill('gyro x');
  await shots(page, 'flight-signals-choice');
  await search.fill(`${estimate} body_rates x`);
  await search.press('Enter');
  const plot = signals.getByRole('img').first();
  await drawn(page, plot, 'the rate');
  await button('Add a signal…').click();
  await dragged('residuals height 2 innovation');
  await button('Close the list').click();
  await until('two charts', async () => (await charted()).length === 2);
  const names = await charted();
  assert(/^residuals_\d+\[height 2/.test(names[1]), names.join());
  await until('its address', async () => decodeURIComponent(page.url()).includes(`?signals=${names.join()}`));
  const box = await region('Altitude chart').getByRole('img').first().boundingBox();
  await page.mouse.move(box.x + 0.6 * box.width, box.y + box.height / 2);
  const values = await until('their values under the cursor', async () => {
    const texts = await signals.locator('.signal-value b').allTextContents();
    return texts.length === 2 && texts.every((text) => Number.isFinite(number(text))) && texts;
  });
  for (const one of await signals.getByRole('img').all()) await drawn(page, one, await one.getAttribute('aria-label'));
  await shots(page, 'flight-signals');
  return { names, values };
});

await step(page, 'signals: what is zoomed into is read more finely', async () => {
  const asked = [];
  page.on('response', async (response) => {
    if (!/\/signal\?/.test(response.url())) return;
    // An answer that the browser has let go of already is none that is shown.
    const answer = await response.json().catch(() => undefined);
    if (answer) asked.push({ from: Number(new URL(response.url()).searchParams.get('from_s')), ...answer });
  });
  const plot = region('Altitude chart').getByRole('img').first();
  const box = await plot.boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  for (let i = 0; i < 8; i += 1) await page.mouse.wheel(0, -120);
  const fine = await until('finer samples', async () => asked.find((answer) => answer.from > 0));
  const step = (answer) => (answer.time_s.at(-1) - answer.time_s[0]) / answer.time_s.length;
  assert(step(fine) < 0.012 && fine.samples >= fine.time_s.length, `a sample each ${step(fine)} s`);
  await page.keyboard.press('Escape');
  return { samples: fine.samples };
});

await step(page, 'signals: a spectrum with the rotors marked, between the cursors too', async () => {
  const [name] = await charted();
  const group = signals.getByRole('group', { name, exact: true });
  await group.getByRole('button', { name: 'Spectrum' }).click();
  await signals.getByText(/peak [\d.]+ Hz; in view, mean of \d+ windows; dashed: rotors, [\d.]+ Hz, 1 to 4 times/).waitFor();
  const whole = await signals.locator('.density > p').textContent();
  assert((await signals.locator('.density svg path').count()) >= 5, 'no rotors');
  await shots(page, 'flight-spectrum');
  await page.keyboard.press('m');
  await signals.getByText(/between the cursors/).waitFor();
  await page.keyboard.press('m');
  await signals.getByText(/in view/).waitFor();
  return { whole };
});

await step(page, 'signals: two stretches lie over one another, with the rotors and the RMS of each', async () => {
  const rms = (text) => number(/RMS ([\d.]+)/.exec(text)?.[1]);
  await page.keyboard.press('m');
  const cursors = region('Cursors');
  const between = async (a, b) => {
    await cursors.getByLabel(/Time of cursor A/).fill(String(a));
    await cursors.getByLabel(/Time of cursor B/).fill(String(b));
    await page.keyboard.press('Tab');
  };
  const told = signals.locator('.density > p:not(.kept)').first();
  const lines = () => signals.locator('.density svg path').count();
  await between(1, 5);
  await until('the first stretch', async () => /between the cursors/.test(await told.textContent()));
  const before = await lines();
  await button('Keep').click();
  const kept = signals.locator('.density .kept').first();
  await until('it to be kept', async () => /A: RMS [\d.]+ rad\/s.*1\.0 to 5\.0 s/.test(await kept.textContent()));
  await between(6, 12);
  await until('both', async () => (await lines()) > before && rms(await told.textContent()) !== rms(await kept.textContent()));
  const [a, b, times] = [rms(await kept.textContent()), rms(await told.textContent()), number(/B has ([\d.]+) times/.exec(await kept.textContent())?.[1])];
  assert(Math.abs(times - b / a) < 0.02 * times, `${b} / ${a} is not ${times}`);
  await shots(page, 'flight-spectra');
  await button('Keep').click();
  await kept.waitFor({ state: 'detached' });
  await page.keyboard.press('m');
  return { a, b, times };
});

await step(page, 'signals: the address shows the same to others, and says what there is not', async () => {
  const before = await charted();
  await page.goto(page.url());
  await until('the same charts', async () => (await charted()).join() === before.join());
  await signals.getByText(/peak [\d.]+ Hz/).waitFor();
  await button(`Take ${before[0]} away`).click();
  await until('one chart', async () => (await charted()).length === 1);
  assert(!page.url().includes('body_rates'), page.url());
  await page.setViewportSize({ width: 390, height: 844 });
  await signals.evaluate((card) => card.scrollIntoView());
  await shots(page, 'flight-signals', '390x844');
  await page.setViewportSize({ width: 1280, height: 720 });
  await page.goto(`${url}/flights/${flight.id}?signals=no.such.signal`);
  await signals.getByRole('alert').getByText(/no signal "no.such.signal"/).waitFor();
});

await step(page, 'a long flight opens thinned; what is looked at comes whole, and its errors are those of its report', async () => {
  const { flights: [long] } = await steppedWith(page, 'long', 300, ['lanes']);
  const asked = [];
  page.on('request', (request) => {
    const { pathname, searchParams } = new URL(request.url());
    if (pathname.endsWith('/frames')) asked.push({ what: Object.fromEntries(searchParams), from: request.url() });
  });
  const begun = Date.now();
  await page.goto(`${url}/flights/${long}`);
  await page.getByRole('slider', { name: /Position in the flight/ }).waitFor();
  const opened_ms = Date.now() - begun;
  await until('the overview', async () => asked.length >= 1);
  await page.waitForTimeout(1500);
  assert(asked.length === 1, JSON.stringify(asked));
  const bytes = (await (await page.request.get(asked[0].from)).body()).length;
  assert(asked[0].what.columns === '600' && bytes < 4e6, `${bytes} B, ${JSON.stringify(asked)}`);
  const plot = region('Altitude chart').getByRole('img').first();
  await drawn(page, plot, 'the altitude');
  // Nothing is drawn as a gap but what is one.
  const box = await plot.boundingBox();
  await page.mouse.move(box.x + 0.6 * box.width, box.y + box.height / 2);
  const legend = region('Altitude chart').getByRole('list').first();
  await until('a value under the cursor', async () => /0\.\d{3}/.test(await legend.textContent()));
  for (let i = 0; i < 12; i += 1) await page.mouse.wheel(0, -120);
  const fine = await until('every sample of what is zoomed into', async () => asked.find(({ what }) => what.from_s && !what.columns));
  assert(fine.what.kinds.includes('residuals') && Number(fine.what.to_s) - Number(fine.what.from_s) < 62, JSON.stringify(fine.what));
  await page.keyboard.press('Escape');
  await button('Errors').first().click();
  const rms = await until('the errors of the whole flight', async () => {
    const text = await region('Errors').getByRole('listitem').first().textContent();
    return number(/(\d+\.\d)$/.exec(text)?.[1]) || false;
  }, 60_000);
  await shots(page, 'flight-long-errors');
  let read = 0;
  page.on('response', async (response) => {
    if (/\/(frames|figures)/.test(response.url())) read += (await response.body().catch(() => '')).length;
  });
  const opening = Date.now();
  await page.goto(`${url}/flights/${long}/report`);
  await page.locator('article.report .lead').waitFor();
  const ms = Date.now() - opening;
  // What has come is counted a moment after it is shown.
  await until('what the report reads', async () => read > 1e5);
  const report = { ms, bytes: read };
  assert(read < 4e6, `the report reads ${read} B`);
  const row = page.getByRole('row').filter({ hasText: /^\d*Secure \(lanes\)/ }).first();
  const reported = number(await row.getByRole('cell').nth(2).textContent());
  assert(Math.abs(rms - reported) < 0.15, `${rms} mm, and ${reported} mm in the report`);
  return { opened_ms, bytes, rms, reported, report };
});

await step(page, 'fly again: under two estimators, as it was then, not attacked and as drafted, laid over the flight', async () => {
  const { flights: [flown] } = await steppedWith(page, 'again', 30, ['lanes']);
  await page.goto(`${url}/flights/${flown}`);
  const card = region('Fly again');
  const tick = (name) => card.getByRole('checkbox', { name, exact: true });
  assert((await tick('EKF with biases').isChecked()) && (await tick('Secure (lanes)').isChecked()) && (await tick('as it was then').isChecked()), 'another beginning');
  await tick('as it was then').uncheck();
  assert(await card.getByRole('button', { name: /^Fly again/ }).isDisabled(), 'nothing is to be flown');
  await tick('not at all').check();
  await card.getByText('Draft an attack').click();
  const form = card.getByRole('form', { name: 'New attack' });
  await form.getByLabel(/^magnitude/).fill('99');
  await form.getByRole('button', { name: 'Add' }).click();
  await until('the refusal beside the form', async () => /beyond the vehicle's limit/.test(await form.getByRole('alert').textContent()));
  await form.getByLabel(/^magnitude/).fill('0.5');
  await form.getByLabel(/^start/).fill('12');
  await form.getByLabel(/^duration/).fill('6');
  await form.getByRole('button', { name: 'Add' }).click();
  await card.getByText('height 2: bias +0.5 m, from 12 s on for 6 s').waitFor();
  for (let n = 0; n < 2; n += 1) await form.getByRole('button', { name: 'Add' }).click();
  await card.getByRole('alert').getByText('At most 7 at once').waitFor();
  for (let n = 0; n < 2; n += 1) await card.getByRole('button', { name: 'Remove from draft' }).first().click();
  await card.scrollIntoViewIfNeeded();
  await shots(page, 'fly-again');
  await card.getByRole('button', { name: 'Fly again, 4 flights' }).click();
  await page.waitForURL(/\/flights\/[^/]*,/, { timeout: 90_000 });
  const legend = region('Altitude of each flight').getByRole('listitem');
  await until('five flights', async () => (await legend.count()) >= 5, 30_000);
  const names = (await legend.allTextContents()).join(' | ');
  for (const name of ['EKF with biases, not attacked', 'Secure (lanes), not attacked', 'EKF with biases, height 2: bias +0.5 m', 'Secure (lanes), height 2: bias +0.5 m']) {
    assert(names.includes(name), `${name} is not among ${names}`);
  }
  // What was drafted was done: no sign was drawn.
  const attacked = new URL(page.url()).pathname.split('/').at(-1).split(',').slice(3);
  for (const id of attacked) {
    const { attacks } = await asks(page, 'GET', `flights/${id}`);
    assert(attacks.length === 1 && attacks[0].magnitude === 0.5 && attacks[0].kind === 'bias' && attacks[0].instance === 2, JSON.stringify(attacks));
  }
  await drawn(page, region('Altitude of each flight').getByRole('img').first(), 'five altitudes');
  await shots(page, 'fly-again-compared');
  return { names };
});

await step(page, 'signals: no complaint in the console', async () => {
  // The signal that there is not.
  const others = errors.filter((text) => !/status of 4(22|00)/.test(text));
  assert(others.length === 0, others.join('\n'));
});

await browser.close();
end();
