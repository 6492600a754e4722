"""Messages by topic of an MCAP file, as JSON: read by the third-party `mcap` package, in file order and by summary."""

import json
import sys
from collections import Counter

from mcap.reader import make_reader

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    counts = Counter(channel.topic for _, channel, _ in reader.iter_messages())
    summary = reader.get_summary()

promised = {summary.channels[id].topic: n for id, n in summary.statistics.channel_message_counts.items() if n > 0}
if promised != dict(counts):
    sys.exit(f"the summary says {promised}, the file holds {dict(counts)}")
json.dump(counts, sys.stdout, sort_keys=True)
