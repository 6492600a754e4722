"""Makes one WebP of the frames of `picture.mjs`: FOLDER TARGET."""

import sys
from pathlib import Path

from PIL import Image

folder, target = sys.argv[1:]
frames = [Image.open(path).convert("RGB").resize((1024, 576), Image.Resampling.LANCZOS) for path in sorted(Path(folder).glob("picture-*.png"))]
first, *others = frames
first.save(target, save_all=True, append_images=others, duration=250, loop=0, quality=60, method=6, minimize_size=True)
