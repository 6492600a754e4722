// What the browser scripts share: the browser, numbered steps, and eyes for pixels.

import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { spawnSync } from 'node:child_process';
import { join } from 'node:path';

export const need = (name) => {
  const value = process.env[name];
  if (!value) throw new Error(`${name} is not set; these scripts are run by cargo xtask`);
  return value;
};

const modules = need('PLUMBLINE_MODULES');
const { chromium } = createRequire(`${modules}/`)('playwright-core');
export const { ws: Socket } = createRequire(`${modules}/`)(join(modules, 'node_modules/playwright-core/lib/utilsBundle.js'));

export const url = need('PLUMBLINE_URL');
export const screenshots = need('PLUMBLINE_SCREENSHOTS');

/**
 * A picture for people, of a page or a part of it, and only where they ask for them (PLUMBLINE_SHOTS=1): none is compared with anything,
 * and each waits until what was pressed last is drawn. `looks.mjs` compares its own.
 */
export async function shot(of, name, options) {
  if (process.env.PLUMBLINE_SHOTS !== '1') return;
  await new Promise((resolve) => setTimeout(resolve, 400));
  await of.screenshot({ path: `${screenshots}/${name}.png`, ...options });
}

/** The same in both themes, from light to light. */
export async function shots(page, name, size = '1280x720') {
  if (process.env.PLUMBLINE_SHOTS !== '1') return;
  for (const theme of ['light', 'dark']) {
    await shot(page, `${name}-${theme}-${size}`);
    await page.getByRole('button', { name: 'Dark theme', exact: true }).click();
  }
}

const LAUNCHES = 3;

// Headless Chromium draws WebGL2 in software without flags; root needs the sandbox off. A graphics card is used where
// PLUMBLINE_CHROMIUM_FLAGS say how. It may die by itself before there is a page: then it is started again, and that is told.
export const launch = async (...more) => {
  const flags = (process.env.PLUMBLINE_CHROMIUM_FLAGS ?? '').split(/\s+/).filter(Boolean);
  const args = ['--no-sandbox', '--disable-dev-shm-usage', ...flags, ...more];
  for (let tries = 1; ; tries += 1) {
    try {
      return await chromium.launch({ executablePath: need('PLUMBLINE_CHROMIUM'), args });
    } catch (error) {
      if (tries === LAUNCHES) throw error;
      console.error(`Chromium did not start, once more: ${error.message}`);
    }
  }
};

let failures = 0;
const MOST_FAILURES = 4;

/** One step: a line of JSON for xtask. What it returns is told as a note. A page that is broken is left early. */
export async function step(page, name, work) {
  if (failures >= MOST_FAILURES) return undefined;
  const begun = Date.now();
  try {
    const note = await work();
    console.log(JSON.stringify({ step: name, ok: true, note, ms: Date.now() - begun }));
    return note;
  } catch (error) {
    failures += 1;
    const file = `${screenshots}/failed-${name.replace(/[^a-z0-9]+/gi, '-').slice(0, 60)}.png`;
    await page?.screenshot({ path: file }).catch(() => {});
    // Where nobody can see the picture: what the page itself says of it.
    const said = await page?.locator('.arm-checks summary, .notice').allTextContents().catch(() => []);
    const texts = said?.length ? `\n(the page says: ${said.map((text) => text.trim()).join(' | ')})` : '';
    console.log(JSON.stringify({ step: name, ok: false, error: `${error.message ?? error}${texts}\n(see ${file})` }));
    return undefined;
  }
}

/** The end of a script: tells xtask that it was reached. */
export function end() {
  console.log(JSON.stringify({ end: true }));
  process.exit(failures === 0 ? 0 : 1);
}

export function assert(condition, message) {
  if (!condition) throw new Error(message);
}

/** Asks until `check` gives something truthy; tells the last answer when it never does. */
export async function until(what, check, limitMs = 20_000) {
  const limit = Date.now() + limitMs;
  let last;
  while (Date.now() < limit) {
    try {
      last = await check();
      if (last) return last;
    } catch (error) {
      last = error.message;
    }
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  throw new Error(`${what}: not within ${limitMs} ms (last: ${JSON.stringify(last)})`);
}

/** The number in a text such as "0.80 m", with a real minus or a hyphen; NaN when there is none. */
export const number = (text) => {
  const found = /[-−+]?\d+(\.\d+)?/.exec(text ?? '');
  return found ? Number(found[0].replace('−', '-')) : NaN;
};

/**
 * Holds a button as a finger would, until `done`. A vehicle that swings may refuse, and a page that is drawing when the pointer comes down
 * counts less of a hold: a person holds the button again.
 */
export async function holdUntil(what, button, done, limitMs) {
  await until(what, async () => {
    if (await button.count()) {
      await button.scrollIntoViewIfNeeded();
      await button.click({ delay: 1100 });
    }
    // A slowed-down page shows later what came of it; another hold would ask for what is done, which is refused.
    for (let n = 0; n < 10 && !(await done()); n += 1) await new Promise((resolve) => setTimeout(resolve, 300));
    return done();
  }, limitMs);
}

/** Arms by its button, once all checks pass. */
export async function armed(page, limitMs) {
  const card = page.getByRole('region', { name: 'Mode and arming', exact: true });
  const arming = page.getByRole('banner').getByLabel('Arming');
  await until('checks to pass', async () => /all \d+ checks pass/.test(await card.textContent()), limitMs);
  const arm = page.getByRole('button', { name: 'Arm (hold)', exact: true });
  await holdUntil('ARMED', arm, async () => /ARMED/.test(await arming.textContent()), limitMs);
}

/** Whoever flies from this page: its places by name, and a flight by its buttons. */
export function pilot(page) {
  const region = (name) => page.getByRole('region', { name, exact: true });
  const button = (name) => page.getByRole('button', { name, exact: true });
  const banner = page.getByRole('banner');
  const setpoint = async () => number(await region('Setpoint').getByLabel('Altitude setpoint in use').textContent());

  const arm = async () => {
    await armed(page);
    await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: /altitude hold/i }).click();
  };
  const to = async (metres) => {
    await button(`Altitude ${metres.toFixed(1)} m`).click();
    await until(`setpoint ${metres}`, async () => Math.abs((await setpoint()) - metres) < 1e-6);
    await page.waitForTimeout(2500);
  };
  const disarm = async () => {
    await to(0.5);
    await holdUntil('disarmed', button('Disarm (hold)'), async () => /disarmed/i.test(await banner.getByLabel('Arming').textContent()));
  };
  return { region, button, banner, setpoint, arm, to, disarm };
}

// What a fixed sum takes where the suite was written with nothing else to do, ms.
const SUM_MS = 150;

/** What the same sum takes on this page now, ms. */
async function summed(page) {
  const sums = [];
  for (let n = 0; n < 9; n += 1) {
    sums.push(await page.evaluate(() => {
      const begun = performance.now();
      let x = 0;
      for (let n = 0; n < 2e7; n += 1) x = (x * 31 + n) | 0;
      globalThis.sum = x;
      return performance.now() - begun;
    }));
  }
  return median(sums);
}

/**
 * What is promised within `ms` on that machine or a faster one; on one that is slower or busy, within as much longer as its sum takes on
 * this page, three times at most.
 */
export const within = async (page, ms) => Math.round(ms * Math.min(3, Math.max(1, (await summed(page)) / SUM_MS)));

/** Has a page run on a processor `times` slower than that; a machine that is slow or busy already is slowed down by that much less. */
export async function slowed(page, times = 4) {
  const sum_ms = await summed(page);
  const rate = Math.min(times, Math.max(1, (times * SUM_MS) / sum_ms));
  const cpu = await page.context().newCDPSession(page);
  const throttle = (rate) => cpu.send('Emulation.setCPUThrottlingRate', { rate });
  await throttle(rate);
  return { rate, sum_ms, end: () => throttle(1) };
}

/** The integers of a protobuf message under these field numbers; 0 where it has none. */
function varints(bytes, wanted) {
  const found = {};
  for (let at = 0; at < bytes.length;) {
    const read = () => {
      let value = 0, shift = 1;
      for (;;) {
        const byte = bytes[at++];
        value += (byte & 127) * shift;
        shift *= 128;
        if (!(byte & 128)) return value;
      }
    };
    const key = read();
    if (key % 8 === 0) found[Math.floor(key / 8)] = read();
    else if (key % 8 === 1) at += 8;
    else if (key % 8 === 5) at += 4;
    else { const length = read(); at += length; }
  }
  return wanted.map((field) => found[field] ?? 0);
}

/** What the vehicle says, past the page: newest flight time, mode, arming, failsafes; and how old what a page shows is, s. */
export function listen(id) {
  const KIND = { estimate: 10, status: 30 };
  const vehicle = { newestUs: 0, atMs: 0, mode: 0, armed: false, failsafes: new Set() };
  const live = new Socket(`${url.replace('http', 'ws')}/api/v1/vehicles/${id}/live`);
  live.on('message', (data) => {
    for (let at = 2; at + 24 <= data.length;) {
      const end = at + 24 + data.readUInt32LE(at + 4);
      const kind = data.readUInt16LE(at);
      const us = Number(data.readBigUInt64LE(at + 16));
      if (kind === KIND.estimate && us > vehicle.newestUs) [vehicle.newestUs, vehicle.atMs] = [us, performance.now()];
      if (kind === KIND.status) {
        const [mode, armed, failsafe] = varints(data.subarray(at + 24, end), [2, 3, 5]);
        Object.assign(vehicle, { mode, armed: armed === 1 });
        if (failsafe) vehicle.failsafes.add(failsafe);
      }
      at = end;
    }
  });
  vehicle.age = async (page) => {
    const shown = await page.evaluate(() => Number(document.querySelector('[data-time-us]')?.dataset.timeUs ?? NaN));
    return (vehicle.newestUs - shown) * 1e-6 + (performance.now() - vehicle.atMs) * 1e-3;
  };
  return vehicle;
}

/** Milliseconds from navigation until what the page shows is less than half a second old. */
export async function liveAfter(page, vehicle) {
  const begun = performance.now();
  await page.goto(url, { waitUntil: 'commit' });
  await until('live numbers', async () => (await vehicle.age(page)) < 0.5, 60_000);
  return Math.round(performance.now() - begun);
}

export const median = (all) => all.toSorted((a, b) => a - b)[Math.floor(all.length / 2)];

/**
 * What an element (or a part of its box) shows, canvas behind it included: number of colours, share of the most common
 * one, of some colours, of the bare page where nothing is drawn; a digest.
 * Counters can rise while nothing is drawn, so only pixels count.
 */
export async function pixels(page, locator, part = (box) => box) {
  const whole = await locator.boundingBox();
  const box = whole && part(whole);
  assert(box && box.width > 8 && box.height > 8, `nothing to look at: ${JSON.stringify(box)}`);
  const png = (await page.screenshot({ clip: box })).toString('base64');
  return page.evaluate(async (png) => {
    const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes], { type: 'image/png' }));
    const canvas = new OffscreenCanvas(image.width, image.height);
    const context = canvas.getContext('2d');
    context.drawImage(image, 0, 0);
    const data = context.getImageData(0, 0, image.width, image.height).data;
    const counts = new Map();
    let digest = 0;
    for (let i = 0; i < data.length; i += 4) {
      const colour = (data[i] << 16) | (data[i + 1] << 8) | data[i + 2];
      counts.set(colour, (counts.get(colour) ?? 0) + 1);
      digest = (Math.imul(digest, 31) + colour) | 0;
    }
    const most = Math.max(...counts.values());
    const near = (r, g, b) => {
      let found = 0;
      for (const [colour, count] of counts) {
        const d = Math.abs((colour >> 16) - r) + Math.abs(((colour >> 8) & 255) - g) + Math.abs((colour & 255) - b);
        if (d < 60) found += count;
      }
      return found / (data.length / 4);
    };
    return {
      width: image.width, height: image.height, colours: counts.size, common: most / (data.length / 4), digest,
      blue: near(0x00, 0x72, 0xb2), vermilion: near(0xd5, 0x5e, 0x00),
      page: (counts.get(0xf3f4f6) ?? 0) / (data.length / 4),
    };
  }, png);
}

/** Fails unless something is drawn there. */
export async function drawn(page, locator, name) {
  const seen = await until(`${name} to be drawn`, async () => {
    const seen = await pixels(page, locator);
    return seen.colours >= 4 && seen.common < 0.998 ? seen : false;
  }, 8000);
  return { name, colours: seen.colours, common: Number(seen.common.toFixed(4)), digest: seen.digest };
}

/** Topic → messages of a flight file, by the third-party Python reader. */
export function countMcap(file) {
  const script = new URL('./count.py', import.meta.url).pathname;
  const ran = spawnSync(need('PLUMBLINE_PYTHON'), [script, file], { encoding: 'utf8', maxBuffer: 1 << 24 });
  assert(ran.status === 0, `count.py: ${ran.stderr}`);
  return JSON.parse(ran.stdout);
}

/** What the ground answers to a request of its API, made beside the page; refused is failed. */
export async function asks(page, method, path, data) {
  // Flights of minutes are flown meanwhile, on a machine that may have other things to do.
  const answer = await page.request.fetch(`${url}/api/v1/${path}`, { method, data, headers: { 'X-Plumbline-Operator': 'browser' }, timeout: 120_000 });
  assert(answer.ok(), `${method} ${path}: ${await answer.text()}`);
  return answer.json();
}

/** Flies a step on the string rig, `duration_s` long, with each of these estimators in the loop; it is the same flight whenever it is flown. */
export async function steppedWith(page, name, duration_s, estimators) {
  const plan = `name = "${name}"
repeats = 1
seed = 5
[scenario]
world = "datasheet"
duration_s = ${duration_s}
suite = { preset = "string_rig" }
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
[[scenario.script]]
at_s = 3
do = "arm"
[[scenario.script]]
at_s = 4
do = "mode"
mode = "altitude_hold"
[[scenario.script]]
at_s = 5
do = "setpoint"
altitude_m = 0.9
[[factor]]
key = "agent.estimators.in_loop"
values = [${estimators.map((estimator) => `"${estimator}"`).join(', ')}]
`;
  const { id: experiment } = await asks(page, 'POST', 'experiments', { plan });
  const flights = [];
  for (const index of estimators.keys()) flights.push((await asks(page, 'POST', `experiments/${experiment}/flights/${index}`)).flight);
  return { experiment, flights };
}

let axe;
/**
 * What axe-core finds on a page as it is: grave findings, and how many lesser ones. A region without a heading of its own is grave here,
 * which axe does not ask for. The numbers of the pitch ladder lie on the canvas, which axe takes for the bare page.
 */
export async function findings(page) {
  axe ??= readFileSync(createRequire(`${modules}/`).resolve('axe-core/axe.min.js'), 'utf8');
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run({ exclude: [['.ladder']] }, { resultTypes: ['violations'] }));
  const grave = violations.filter((found) => ['serious', 'critical'].includes(found.impact));
  const headless = await page.evaluate(() => [...document.querySelectorAll('section[aria-label], section[aria-labelledby], [role=region]')]
    .filter((region) => region.checkVisibility() && ![...region.querySelectorAll('h1, h2, h3, h4, h5, h6')].some((heading) => heading.textContent.trim()))
    .map((region) => `no heading in ${region.getAttribute('aria-label')}`));
  return {
    grave: grave.flatMap((found) => found.nodes.map((node) => `${found.id} ${node.target.join(' ')}: ${node.html.slice(0, 120)} ${node.any[0]?.message ?? ''}`)).concat(headless),
    lesser: violations.filter((found) => !grave.includes(found)).map((found) => `${found.id} ×${found.nodes.length}`),
  };
}

/** Fails where axe-core finds something grave, in either theme, of a page that goes by the browser's. */
export async function accessible(page) {
  for (const colorScheme of ['dark', 'light']) {
    await page.emulateMedia({ colorScheme });
    const { grave } = await findings(page);
    assert(grave.length === 0, `${colorScheme}: ${grave.length} findings\n${grave.slice(0, 12).join('\n')}`);
  }
}

/** Counts what the browser complains about. */
export function complaints(page) {
  const all = [];
  page.on('console', (message) => {
    if (message.type() === 'error') all.push(`${message.text()} ${message.location().url}`);
  });
  page.on('pageerror', (error) => all.push(`${error.name}: ${error.message}`));
  return all;
}
