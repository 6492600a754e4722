// How every page looks, in both themes and four sizes, beside pictures that were looked at and found well (`looks/`, half the size).
// Nothing moves: a recording flown again stands still at one tick, and the flights of an experiment are the same whenever they are flown. What
// no two runs share (times of day, sizes of disks, ages, addresses) is hidden; of the rest squares are compared by their mean
// colour, so that neither a rasteriser nor a digit tells, and a line of text that has moved does.
// With PLUMBLINE_BLESS=1 the pictures are written anew; then they want to be looked at.

import { existsSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';

import { asks, assert, complaints, end, launch, screenshots, step, steppedWith, until, url } from './support.mjs';

const FOLDER = new URL('./looks/', import.meta.url).pathname;
const BLESS = process.env.PLUMBLINE_BLESS === '1';
const SIZES = [[1280, 720], [1440, 900], [820, 1180], [390, 844]];
const THEMES = ['light', 'dark'];
// Side of a square, px of the halved picture; its mean colour may change by so much of 255, and so many of a thousand squares by more.
const SQUARE = 8;
const CHANGE = 14;
const SQUARES = 3;
// A picture that differs is looked at so often before it counts.
const LOOKS = 5;
const LOOK_MS = 350;
// The first look comes sooner: what looks as its picture does has been drawn.
const FIRST_MS = 100;
// A picture that is kept was looked at once: a canvas that was not painted yet would be kept as it was.
const SETTLED_MS = 2000;
// Ticks until the recording stands still: half a minute of it, in flight.
const TICKS = 1500;
// What no two runs share. Its room stays, so its place is looked at all the same.
const HIDDEN = `.tag.link, .lease, .tune-measured, .notices, .page-alarms, .hint-bubble { visibility: hidden !important }
  :is([aria-label="Ground station"], [aria-label="Page"], [aria-label="Link"]) dd { visibility: hidden; white-space: nowrap; overflow: hidden }
  *, *::before, *::after { caret-color: transparent !important; transition: none !important; animation: none !important }`;
// Nor what a live vehicle draws: it stands still here, and yet is told of in another rhythm each time.
const LIVE = 'canvas, .lanes li, .y-labels, .x-labels, .steps, .res-row, .motor, .tape, .compass, .readout dd, .state { visibility: hidden !important }';

const browser = await launch();
const context = await browser.newContext({ colorScheme: 'light', viewport: { width: 1280, height: 720 }, reducedMotion: 'reduce', timezoneId: 'UTC', locale: 'en-GB' });
const page = await context.newPage();
page.setDefaultTimeout(15_000);
const errors = complaints(page);
// Pixels are counted beside the page, not on it.
const bench = await context.newPage();

/** Halves a picture: as a file to keep, or beside the one that was kept, which squares differ and by how much. */
const compared = (shot, kept) => bench.evaluate(async ([shot, kept, side]) => {
  const read = async (picture, shrunk) => {
    const image = await createImageBitmap(await (await fetch(`data:image/*;base64,${picture}`)).blob());
    const canvas = new OffscreenCanvas(Math.round(image.width / shrunk), Math.round(image.height / shrunk));
    const context = canvas.getContext('2d', { willReadFrequently: true });
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    return { width: canvas.width, height: canvas.height, canvas, data: context.getImageData(0, 0, canvas.width, canvas.height).data };
  };
  const now = await read(shot, 2);
  const { width, height } = now;
  if (!kept) {
    const bytes = new Uint8Array(await (await now.canvas.convertToBlob({ type: 'image/webp', quality: 0.8 })).arrayBuffer());
    return { file: btoa(Array.from(bytes, (b) => String.fromCharCode(b)).join('')) };
  }
  const was = await read(kept, 1);
  if (was.width !== width || was.height !== height) return { sizes: [[2 * width, 2 * height], [2 * was.width, 2 * was.height]].map((size) => size.join('×')) };
  const squares = [];
  for (let top = 0; top < height; top += side) {
    for (let left = 0; left < width; left += side) {
      const sums = [0, 0, 0];
      let count = 0;
      for (let y = top; y < Math.min(height, top + side); y += 1) {
        for (let x = left; x < Math.min(width, left + side); x += 1) {
          for (let c = 0; c < 3; c += 1) sums[c] += now.data[4 * (y * width + x) + c] - was.data[4 * (y * width + x) + c];
          count += 1;
        }
      }
      squares.push([2 * left, 2 * top, Math.round(Math.max(...sums.map(Math.abs)) / count)]);
    }
  }
  return { squares };
}, [shot.toString('base64'), kept?.toString('base64'), SQUARE]);

const theme = () => page.evaluate(() => document.documentElement.dataset.theme);
const seen = new Set();

/** What differs between the page as it is and its picture, in words; nothing if they are the same. */
async function difference(which, hidden) {
  const shot = await page.screenshot({ path: `${screenshots}/looks-${which}.png`, style: HIDDEN + hidden });
  const file = `${FOLDER}${which}.webp`;
  if (BLESS) return writeFileSync(file, Buffer.from((await compared(shot)).file, 'base64'));
  if (!existsSync(file)) return `${which} was never looked at`;
  const { squares, sizes } = await compared(shot, readFileSync(file));
  if (sizes) return `${which} is ${sizes[0]}, was ${sizes[1]}`;
  const differ = squares.filter(([, , change]) => change > CHANGE).toSorted((a, b) => b[2] - a[2]);
  const share = (1000 * differ.length) / squares.length;
  if (share <= SQUARES) return undefined;
  return `${which}: ${share.toFixed(1)} ‰ of its squares differ, at ${differ.slice(0, 6).map(([x, y, change]) => `${x},${y} by ${change}`).join('; ')}`;
}

/** Every size and theme of what is first seen of the page that is open, held against the pictures. */
async function looks(name, hidden = '') {
  const wrong = [];
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    for (const wanted of THEMES) {
      if ((await theme()) !== wanted) await page.getByRole('button', { name: 'Dark theme' }).evaluate((button) => button.click());
      await page.evaluate(() => { document.activeElement?.blur(); scrollTo(0, 0); });
      await page.mouse.move(1, 1);
      const which = `${name}-${wanted}-${width}x${height}`;
      seen.add(`${which}.webp`);
      // What is being drawn is looked at again.
      let told;
      for (let look = 0; look < (BLESS ? 1 : LOOKS); look += 1) {
        await page.waitForTimeout(BLESS ? SETTLED_MS : look === 0 ? FIRST_MS : LOOK_MS);
        told = await difference(which, hidden);
        if (!told) break;
      }
      if (told) wrong.push(told);
    }
  }
  assert(wrong.length === 0, `${wrong.length} pictures differ from those in tests/browser/looks; are they better, bless them (PLUMBLINE_BLESS=1); by Chromium ${browser.version()}\n${wrong.join('\n')}`);
}

let experiment;
let flights = [];
await step(page, 'looks: two flights to look at, and a recording that stands still', async () => {
  ({ experiment, flights } = await steppedWith(page, 'looks', 30, ['ekf_bias', 'lanes']));
  await until('the experiment to be flown', async () => (await asks(page, 'GET', `experiments/${experiment}`)).state.done === 2, 60_000);
  // An id tells when it was flown.
  for (const [index, name] of ['Steps with biases', 'Steps with lanes'].entries()) await asks(page, 'PATCH', `flights/${flights[index]}`, { name, notes: '' });
  // No more at a time than the radio carries: of a burst it gives up what comes last.
  for (let ticks = 0; ticks < TICKS; ticks += 100) {
    await asks(page, 'POST', 'vehicles/iris-1/replay', { speed: 0, step: 100 });
    await page.waitForTimeout(200);
  }
  await page.goto(url);
  await until('the recording to stand still', async () => {
    const before = await page.getByRole('progressbar', { name: 'Progress of the recording' }).evaluate((bar) => bar.value);
    await page.waitForTimeout(700);
    return before > 0 && before === (await page.getByRole('progressbar', { name: 'Progress of the recording' }).evaluate((bar) => bar.value));
  }, 60_000);
});

const heading = () => page.getByRole('heading', { level: 1 }).first().waitFor({ state: 'attached' });
const PAGES = {
  fly: ['/', () => page.getByRole('region', { name: 'Altitude chart' }).waitFor(), LIVE],
  // Soon: two minutes after the recording stands still, nobody has the curve of its step any more.
  tune: ['/tune', async () => {
    await page.locator('.tune-steps .legend').getByText('measured').waitFor();
    await page.locator('.tune-steps:not(.stale) svg path').first().waitFor({ state: 'attached' });
  }],
  flights: ['/flights', () => page.getByRole('row').nth(2).waitFor()],
  flight: [`/flights/${flights[0]}`, () => page.getByRole('slider', { name: /Position in the flight/ }).waitFor()],
  report: [`/flights/${flights[0]}/report`, heading],
  compare: [`/flights/${flights.join(',')}`, heading],
  experiments: [`/experiments?experiment=${experiment}`, heading],
  calibrate: ['/calibrate', () => page.getByRole('button', { name: 'Fit and keep' }).waitFor()],
  setup: ['/setup', async () => {
    await page.getByRole('region', { name: 'Vehicle' }).getByText('hanging_strings', { exact: true }).waitFor();
    const envelope = page.getByRole('region', { name: 'Attack envelope' });
    await envelope.getByText('height 1', { exact: true }).waitFor({ timeout: 60_000 });
    await envelope.getByText(/^motion capture/).waitFor({ timeout: 60_000 });
  }],
  help: ['/calibrate', async () => {
    await page.getByRole('button', { name: 'Fit and keep' }).waitFor();
    await page.keyboard.press('?');
    await page.getByRole('dialog').waitFor();
  }],
  nowhere: ['/nowhere', heading],
};
if (BLESS) {
  rmSync(FOLDER, { recursive: true, force: true });
  mkdirSync(FOLDER, { recursive: true });
}
for (const [name, [path, ready, hidden]] of Object.entries(PAGES)) {
  await step(page, `looks: ${name}, light and dark, in four sizes`, async () => {
    await page.setViewportSize({ width: 1280, height: 720 });
    await page.goto(url + path);
    await ready();
    await page.waitForTimeout(1000);
    return looks(name, hidden);
  });
}

await step(page, 'looks: no picture of a page that is gone', async () => {
  const gone = readdirSync(FOLDER).filter((file) => !seen.has(file));
  assert(gone.length === 0, gone.join(', '));
  const said = errors.filter((error) => !error.endsWith('/nowhere'));
  assert(said.length === 0, said.join('\n'));
});

await browser.close();
end();
