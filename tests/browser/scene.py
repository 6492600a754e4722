"""A flight as it is exported for Foxglove, read by the third-party `mcap` and `mcap-protobuf-support`: its channels, every message
decoded by what the file says of it, and how far `/tf` is off the estimate in the loop. Prints what it found, as JSON."""

import json
import sys
from importlib.metadata import version

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

channels, entities, texts, last = {}, set(), [], None
with open(sys.argv[1], "rb") as file:
    reader, factory = make_reader(file, validate_crcs=True), DecoderFactory()
    for schema, channel, message in reader.iter_messages():
        known = channels.setdefault(
            channel.topic,
            {"schema": schema.name, "encodings": [channel.message_encoding, schema.encoding], "messages": 0, "off_m": 0.0},
        )
        known["messages"] += 1
        if channel.message_encoding != "json":
            decoded = factory.decoder_for(channel.message_encoding, schema)(message.data)
            if schema.name == "plumbline.v1.Estimate" and decoded.in_loop:
                last = decoded.position_enu_m, message.log_time
            continue
        told = json.loads(message.data)
        fields = json.loads(schema.data)["properties"]
        assert set(told) == set(fields), f"{channel.topic}: {sorted(told)}, and its schema has {sorted(fields)}"
        if channel.topic == "/tf":
            at, time_ns = last
            stamp = told["timestamp"]["sec"] * 10**9 + told["timestamp"]["nsec"]
            assert stamp == time_ns == message.log_time, f"{stamp} is not {time_ns}"
            off = [told["translation"][axis] - getattr(at, axis) for axis in "xyz"]
            known["off_m"] = max(known["off_m"], *map(abs, off))
        elif channel.topic == "/scene":
            entities.update(entity["id"] for entity in told["entities"])
        elif channel.topic == "/log":
            texts.append(told["message"])
json.dump({"version": version("mcap"), "channels": channels, "entities": sorted(entities), "texts": texts}, sys.stdout)
