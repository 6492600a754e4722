// The live link by the client that Foxglove's own protocol package has: `@foxglove/ws-protocol`.

import { createRequire } from 'node:module';
import { readFileSync } from 'node:fs';
import { agrees } from './schemas.mjs';
import { assert, end, need, step, until, url } from './support.mjs';

const require = createRequire(`${need('PLUMBLINE_MODULES')}/`);
const { FoxgloveClient } = require('@foxglove/ws-protocol');
const WebSocket = require('ws');

const vehicle = (await (await fetch(`${url}/api/v1/vehicles`)).json())[0].id;
const address = `${url.replace('http', 'ws')}/api/v1/vehicles/${vehicle}/foxglove`;

/** A client, and what it was sent. */
function join(operator) {
  const socket = new WebSocket(`${address}?operator=${operator}`, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
  const client = new FoxgloveClient({ ws: socket });
  const seen = { socket, client, channels: new Map(), services: new Map(), calls: new Map(), status: [], trouble: [], info: null, values: new Map() };
  client.on('error', (error) => seen.trouble.push(String(error)));
  client.on('status', (status) => seen.status.push(status.message));
  client.on('serverInfo', (info) => (seen.info = info));
  client.on('advertise', (all) => all.forEach((channel) => seen.channels.set(channel.topic, channel)));
  client.on('advertiseServices', (all) => all.forEach((service) => seen.services.set(service.name, service)));
  client.on('parameterValues', ({ parameters, id }) => seen.values.set(id, parameters));
  client.on('serviceCallResponse', ({ callId, data }) => seen.calls.set(callId, { answer: JSON.parse(new TextDecoder().decode(data)) }));
  client.on('serviceCallFailure', ({ callId, message }) => seen.calls.set(callId, { failure: message }));
  return seen;
}

let calls = 0;
/** Calls a service and waits for what comes of it. */
async function call(seen, name, request, raw) {
  const callId = (calls += 1);
  const text = new TextEncoder().encode(raw ?? JSON.stringify(request));
  const serviceId = seen.services.get(name)?.id ?? name;
  seen.client.sendServiceCallRequest({ serviceId, callId, encoding: 'json', data: new DataView(text.buffer) });
  return until(`an answer of ${name}`, () => seen.calls.get(callId));
}

await step(null, 'foxglove: the live link is that of its own client', async () => {
  const seen = join('foxglove');
  const { client, channels, trouble, status } = seen;
  const counts = new Map();
  const wanted = ['/estimate/1', '/status', '/tf', '/scene'];
  await until('channels', () => wanted.every((topic) => channels.has(topic)));
  const topics = new Map(wanted.map((topic) => [client.subscribe(channels.get(topic).id), topic]));
  const drawn = new Set();
  client.on('message', ({ subscriptionId, timestamp, data }) => {
    const topic = topics.get(subscriptionId);
    if (!topic || timestamp === 0n || data.byteLength === 0) trouble.push(`${topic} ${timestamp} ${data.byteLength}`);
    const { encoding, schemaName, schema } = channels.get(topic) ?? {};
    try {
      if (encoding === 'json') agrees(schemaName, schema, new TextDecoder().decode(data));
    } catch (error) {
      trouble.push(error.message);
    }
    if (topic === '/scene') JSON.parse(new TextDecoder().decode(data)).entities.forEach((entity) => drawn.add(entity.id));
    counts.set(topic, (counts.get(topic) ?? 0) + 1);
  });
  await until('messages', () => wanted.every((topic) => (counts.get(topic) ?? 0) > (topic === '/status' ? 0 : 10)));
  await until('a scene with vehicle and strings', () => drawn.has('vehicle') && drawn.has('string 1'));
  client.close();
  assert(trouble.length === 0 && status.length === 0, [...trouble, ...status].join('; '));
  assert(channels.get('/estimate/1').schemaName === 'plumbline.v1.Estimate', 'schema');
  return { name: seen.info.name, channels: channels.size, drawn: [...drawn].sort(), ...Object.fromEntries(counts) };
});

await step(null, 'foxglove: gains and limits can be read and not set', async () => {
  const seen = join('foxglove');
  await until('the server', () => seen.info && seen.channels.has('/gains'));
  assert(['parameters', 'services'].every((able) => seen.info.capabilities.includes(able)), seen.info.capabilities.join());
  seen.client.getParameters([], 'all');
  const all = await until('parameters', () => seen.values.get('all'));
  const value = (name) => all.find((parameter) => parameter.name === name)?.value;
  assert(value('gains.state_weight')?.length === 16 && value('limits.altitude_max_m') > 0, JSON.stringify(all));
  seen.client.setParameters([{ name: 'limits.altitude_max_m', value: 99 }], 'set');
  const kept = await until('the parameter as it is', () => seen.values.get('set'));
  assert(kept[0].value === value('limits.altitude_max_m'), JSON.stringify(kept));
  assert(seen.status.some((text) => text.includes('read only')), seen.status.join());
  seen.client.close();
  return { parameters: all.length };
});

await step(null, 'foxglove: services are commands under the lease', async () => {
  const [ann, bob] = [join('ann'), join('bob')];
  await until('services', () => ann.services.size === 3 && bob.services.size === 3);
  const lease = (method) => fetch(`${url}/api/v1/vehicles/${vehicle}/lease`, { method, headers: { 'x-plumbline-operator': 'ann' } });
  assert((await lease('PUT')).ok, 'ann takes control');
  const served = await call(ann, 'setpoint', { yaw_rad: 0 });
  assert(served.answer?.stage === 'accepted' || /disarmed|mode/.test(served.failure), JSON.stringify(served));
  const refused = await call(bob, 'setpoint', { yaw_rad: 0 });
  assert(/ann.* holds control/.test(refused.failure), JSON.stringify(refused));
  const post = (path, body) => fetch(`${url}/api/v1/vehicles/${vehicle}/${path}`, {
    method: 'POST', headers: { 'x-plumbline-operator': 'ann', 'content-type': 'application/json' }, body: JSON.stringify(body),
  });
  // After a flight it swings on its strings for minutes, and a cut is released at rest only.
  assert((await post('simulator', { reset: true })).ok, 'the simulator is reset');
  // Whoever holds control or not: everybody may cut. At rest it is only latched, and released again.
  const cut = await call(bob, 'cut', {});
  assert(cut.answer?.stage === 'accepted', JSON.stringify(cut));
  await until('the cut to be released', async () => (await post('release-cut')).ok, 60_000);
  const early = await call(ann, 'mode', { mode: 'altitude_hold' });
  assert(/arm first/.test(early.failure), `a mode while disarmed: ${JSON.stringify(early)}`);
  await until('the vehicle to be armed', async () => (await post('arm')).ok, 60_000);
  const mode = await call(ann, 'mode', { mode: 'altitude_hold' });
  assert(mode.answer?.stage === 'accepted' && !/already/.test(mode.answer.reason), `a mode while armed: ${JSON.stringify(mode)}`);
  assert((await post('disarm')).ok, 'disarmed again');
  await lease('DELETE');
  [ann, bob].forEach((seen) => seen.client.close());
  return { setpoint: served, cut: cut.answer.reason, mode };
});

await step(null, 'foxglove: the layout of the manual shows topics that there are', async () => {
  const seen = join('foxglove');
  const layout = JSON.parse(readFileSync(new URL('../../docs/foxglove.json', import.meta.url), 'utf8'));
  const text = JSON.stringify(layout.configById);
  const topics = [...new Set([...text.matchAll(/"(?:value|topicToRender)":"(\/[a-z0-9_]+(?:\/[a-z0-9_]+)*)/g)].map((found) => found[1]))];
  assert(topics.length >= 5, `topics of the layout: ${topics}`);
  await until(`all of ${topics}`, () => topics.every((topic) => seen.channels.has(topic)));
  const services = [...text.matchAll(/"serviceName":"([^"]+)"/g)].map((found) => found[1]);
  assert(services.length >= 2 && services.every((name) => seen.services.has(name)), `services: ${services}`);
  seen.client.close();
  return { topics, services };
});

await step(null, 'foxglove: what is wrong is answered and loses nothing', async () => {
  const seen = join('foxglove');
  await until('channels', () => seen.channels.has('/control') && seen.services.size === 3);
  let samples = 0;
  const own = seen.client.subscribe(seen.channels.get('/control').id);
  seen.client.on('message', ({ subscriptionId }) => (samples += subscriptionId === own ? 1 : 0));
  const wrong = [
    ['{"op":"subscribe","subscriptions":[{"id":77,"channelId":4242}]}', 'no channel 4242'],
    ['{"op":"subscribe","subscr', 'cannot be read'],
    ['nonsense', 'cannot be read'],
    ['{"op":"fetchAsset","uri":"package://x"}', 'not done here'],
    [new Uint8Array([2, 1, 0, 0, 0, 1]), 'cut short'],
    [new Uint8Array([9, 9, 9]), 'opcode 9'],
  ];
  for (const [message, said] of wrong) {
    seen.socket.send(message);
    await until(said, () => seen.status.some((text) => text.includes(said)));
  }
  assert((await call(seen, 99, {})).failure?.includes('no service 99'), 'a service that there is not');
  assert((await call(seen, 'mode', null, '{"mo')).failure?.includes('EOF'), 'half a request');
  const before = samples;
  await until('samples to go on', () => samples > before + 20);
  seen.client.close();
  assert(seen.trouble.length === 0, seen.trouble.join('; '));
  return { answers: seen.status.length, samples };
});
end();
