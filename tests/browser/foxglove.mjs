// The live link by the client that Foxglove's own protocol package has: `@foxglove/ws-protocol`.

import { createRequire } from 'node:module';
import { assert, end, need, step, until, url } from './support.mjs';

const require = createRequire(`${need('PLUMBLINE_MODULES')}/`);
const { FoxgloveClient } = require('@foxglove/ws-protocol');
const WebSocket = require('ws');

const vehicle = (await (await fetch(`${url}/api/v1/vehicles`)).json())[0].id;
const address = `${url.replace('http', 'ws')}/api/v1/vehicles/${vehicle}/foxglove`;

await step(null, 'foxglove: the live link is that of its own client', async () => {
  const socket = new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
  const client = new FoxgloveClient({ ws: socket });
  const [channels, counts, trouble] = [new Map(), new Map(), []];
  let name = '';
  client.on('error', (error) => trouble.push(String(error)));
  client.on('status', (status) => trouble.push(status.message));
  client.on('serverInfo', (info) => (name = info.name));
  client.on('advertise', (all) => all.forEach((channel) => channels.set(channel.topic, channel)));
  const wanted = ['/estimate/1', '/status', '/tf', '/scene'];
  await until('channels', () => wanted.every((topic) => channels.has(topic)));
  const topics = new Map(wanted.map((topic) => [client.subscribe(channels.get(topic).id), topic]));
  client.on('message', ({ subscriptionId, timestamp, data }) => {
    const topic = topics.get(subscriptionId);
    if (!topic || timestamp === 0n || data.byteLength === 0) trouble.push(`${topic} ${timestamp} ${data.byteLength}`);
    if (topic === '/scene') JSON.parse(new TextDecoder().decode(data)).entities.length > 0 || trouble.push('an empty scene');
    counts.set(topic, (counts.get(topic) ?? 0) + 1);
  });
  await until('messages', () => wanted.every((topic) => (counts.get(topic) ?? 0) > (topic === '/status' ? 0 : 10)));
  client.close();
  assert(trouble.length === 0, trouble.join('; '));
  assert(channels.get('/estimate/1').schemaName === 'plumbline.v1.Estimate', 'schema');
  return { name, channels: channels.size, ...Object.fromEntries(counts) };
});
end();
