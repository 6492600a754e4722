// Flight files by the reader that Foxglove uses, `@mcap/core`: by their index and as a stream, every message either way; and what
// is in Foxglove's own schemas held to those.

import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { basename } from 'node:path';
import { agrees } from './schemas.mjs';
import { assert, end, need, step } from './support.mjs';

const require = createRequire(`${need('PLUMBLINE_MODULES')}/`);
const { McapIndexedReader, McapStreamReader } = require('@mcap/core');
const { decompress } = require('fzstd');

const decompressHandlers = { zstd: (packed, size) => decompress(packed, new Uint8Array(Number(size))) };

async function byIndex(bytes) {
  const readable = {
    size: async () => BigInt(bytes.length),
    read: async (offset, length) => bytes.subarray(Number(offset), Number(offset + length)),
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  let [messages, drawn, last] = [0, 0, 0n];
  const text = new TextDecoder();
  for await (const message of reader.readMessages()) {
    assert(message.logTime >= last, 'not in the order of time');
    last = message.logTime;
    messages += 1;
    const channel = reader.channelsById.get(message.channelId);
    if (channel.messageEncoding !== 'json') continue;
    const schema = reader.schemasById.get(channel.schemaId);
    agrees(schema.name, text.decode(schema.data), text.decode(message.data));
    drawn += 1;
  }
  return { messages, drawn, promised: Number(reader.statistics.messageCount), chunks: reader.chunkIndexes.length };
}

function asStream(bytes) {
  const reader = new McapStreamReader({ validateCrcs: true, decompressHandlers });
  let messages = 0;
  for (let at = 0; at < bytes.length; at += 1 << 20) {
    reader.append(bytes.subarray(at, at + (1 << 20)));
    for (let record = reader.nextRecord(); record; record = reader.nextRecord()) {
      if (record.type === 'Message') messages += 1;
    }
  }
  assert(reader.done(), 'no end');
  return messages;
}

for (const path of process.argv.slice(2)) {
  await step(null, `mcap: ${basename(path)} opens as in Foxglove`, async () => {
    const bytes = readFileSync(path);
    const indexed = await byIndex(bytes);
    const streamed = asStream(bytes);
    assert(indexed.messages > 0 && indexed.messages === indexed.promised, `${JSON.stringify(indexed)} by index`);
    assert(indexed.drawn > 0 === path.includes('.foxglove.'), `${indexed.drawn} messages in Foxglove's schemas`);
    assert(indexed.messages === streamed, `${indexed.messages} by index, ${streamed} as a stream`);
    return { path, ...indexed };
  });
}
end();
