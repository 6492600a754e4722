// The page as it is felt: how soon it is live, what it takes of the machine and how often it draws while a vehicle flies,
// what it is sent, what it takes of memory, how soon a long flight is open. A line of JSON each: the median of five, all five,
// and the limit. With PLUMBLINE_MINUTES the page then stays open for as long, and its memory is told at both ends.

import { readFileSync } from 'node:fs';

import { assert, complaints, drawn, end, launch, listen, liveAfter, median, pilot, slowed, step, steppedWith, until, url } from './support.mjs';

const TIMES = 5;
/** Whoever is measured is watched for this long, ms. */
const SPAN_MS = 6000;
/** In which the kernel counts processor time, on every Linux. */
const TICKS_PER_S = 100;

const vehicle = listen('iris-1');
const browser = await launch();
const system = await browser.newBrowserCDPSession();
const open = async () => {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, colorScheme: 'light' });
  // Frames: sheets that the page's worker gets, or animation frames in which a card draws, by WebGL2 or WebGPU.
  await context.addInitScript(() => {
    window.drawn = 0;
    let drew = false;
    for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced']) {
      const draw = WebGL2RenderingContext.prototype[name];
      WebGL2RenderingContext.prototype[name] = function (...all) {
        drew = true;
        return draw.apply(this, all);
      };
    }
    if (window.GPUQueue) {
      const submit = GPUQueue.prototype.submit;
      GPUQueue.prototype.submit = function (...all) {
        drew = true;
        return submit.apply(this, all);
      };
    }
    const give = Worker.prototype.postMessage;
    Worker.prototype.postMessage = function (...all) {
      window.drawn += 1;
      return give.apply(this, all);
    };
    const ask = window.requestAnimationFrame.bind(window);
    window.requestAnimationFrame = (then) => ask((now) => {
      drew = false;
      then(now);
      if (drew) window.drawn += 1;
    });
  });
  const page = await context.newPage();
  page.setDefaultTimeout(20_000);
  const cdp = await context.newCDPSession(page);
  await cdp.send('Performance.enable');
  await cdp.send('Network.enable');
  return { context, page, cdp, errors: complaints(page) };
};

const tell = (name, unit, all, limit, more = {}) => {
  const round = (x) => Math.round(x * 100) / 100;
  console.log(JSON.stringify({ bench: 'page', name, value: round(median(all)), unit, limit, all: all.map(round), ...more }));
};
const metrics = async (cdp) => Object.fromEntries((await cdp.send('Performance.getMetrics')).metrics.map(({ name, value }) => [name, value]));
const processes = async () => (await system.send('SystemInfo.getProcessInfo')).processInfo;
const gpuS = async () => (await processes()).filter(({ type }) => type === 'GPU').reduce((sum, { cpuTime }) => sum + cpuTime, 0);
/** Processor time of the busiest page's main thread, which bears the number of its process. */
const mainS = async () => {
  const spent = (id) => {
    const [user, kernel] = readFileSync(`/proc/${id}/task/${id}/stat`, 'utf8').split(') ')[1].split(' ').slice(11, 13);
    return (Number(user) + Number(kernel)) / TICKS_PER_S;
  };
  return Math.max(...(await processes()).filter(({ type }) => type === 'renderer').map(({ id }) => spent(id)));
};

/**
 * What a page takes while nobody touches it: percent of a core of its main thread (time of its tasks, which waiting for a core
 * is part of, and processor time) and of the process that draws, frames a second.
 */
const taken = async ({ page, cdp }) => {
  const look = async () => ({ ...(await metrics(cdp)), gpu_s: await gpuS(), main_s: await mainS(), drawn: await page.evaluate(() => window.drawn), at_s: performance.now() / 1e3 });
  const before = await look();
  await page.waitForTimeout(SPAN_MS);
  const after = await look();
  const since = (name) => (after[name] - before[name]) / (after.at_s - before.at_s);
  return { main: 100 * since('TaskDuration'), spent: 100 * since('main_s'), gpu: 100 * since('gpu_s'), frames: since('drawn') };
};
const several = async (measure) => {
  const all = [];
  for (let n = 0; n < TIMES; n += 1) all.push(await measure());
  return all;
};

const { page, cdp, errors, context } = await open();
let sentB = 0;
cdp.on('Network.webSocketFrameReceived', ({ response }) => {
  sentB += response.opcode === 1 ? response.payloadData.length : (response.payloadData.length * 3) / 4;
});

await step(page, 'live after navigation', async () => {
  await page.goto(url);
  await until('a vehicle', async () => (await vehicle.age(page)) < 0.5, 60_000);
  tell('live_after_navigation', 'ms', await several(() => liveAfter(page, vehicle)), 1000);
  const slow = await slowed(page);
  tell('live_after_navigation_slowed', 'ms', await several(() => liveAfter(page, vehicle)), 2000, { times: Number(slow.rate.toFixed(2)) });
  await slow.end();
});

await step(page, 'while it flies', async () => {
  const { arm, to } = pilot(page);
  await page.goto(url);
  await arm();
  await to(0.8);
  for (const window of ['10 s', '30 s', '10 min']) {
    await page.getByLabel('Time window').selectOption({ label: window });
    await page.waitForTimeout(3000);
    const [began, begun] = [sentB, performance.now()];
    const all = await several(() => taken({ page, cdp }));
    const span = { window };
    tell('fly_main_thread', '% of a core', all.map(({ main }) => main), 35, span);
    tell('fly_main_thread_processor', '% of a core', all.map(({ spent }) => spent), 35, span);
    tell('fly_gpu_process', '% of a core', all.map(({ gpu }) => gpu), 40, span);
    tell('fly_frames', 'frames/s', all.map(({ frames }) => frames), 30, span);
    tell('sent', 'kB/s', [(sentB - began) / (performance.now() - begun)], 100, span);
  }
});

await step(page, 'pages without charts', async () => {
  for (const name of ['Setup', 'Flights', 'Experiments', 'Calibrate']) {
    await page.getByRole('navigation', { name: 'Pages' }).getByRole('link', { name }).click();
    await page.waitForTimeout(3000);
    const all = await several(() => taken({ page, cdp }));
    tell('still_main_thread', '% of a core', all.map(({ main }) => main), 5, { page: name });
    tell('still_main_thread_processor', '% of a core', all.map(({ spent }) => spent), 5, { page: name });
    tell('still_gpu_process', '% of a core', all.map(({ gpu }) => gpu), 5, { page: name });
  }
});

await step(page, 'a flight of twelve minutes opens', async () => {
  const { flights: [flight] } = await steppedWith(page, 'twelve-minutes', 720, ['lanes']);
  const ms = [];
  const kB = [];
  // The first time what its charts show is made; a flight that was recorded, not computed, has it from its landing on.
  for (let n = 0; n <= TIMES; n += 1) {
    const fresh = await open();
    let loaded = 0;
    fresh.cdp.on('Network.dataReceived', ({ encodedDataLength }) => { loaded += encodedDataLength; });
    // The page itself comes from the cache of one that was open before.
    await fresh.page.goto(`${url}/flights`);
    await fresh.page.getByRole('heading', { name: 'Flights', exact: true }).first().waitFor();
    await fresh.page.waitForTimeout(1000);
    loaded = 0;
    const begun = performance.now();
    await fresh.page.goto(`${url}/flights/${flight}`, { waitUntil: 'commit' });
    // Its samples have been read, and a frame been drawn since.
    await until('its estimate', () => fresh.page.evaluate(() => Number(document.querySelector('[data-time-us]')?.dataset.timeUs) > 0), 60_000);
    await fresh.page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    ms.push(performance.now() - begun);
    await drawn(fresh.page, fresh.page.getByRole('region', { name: 'Altitude chart', exact: true }).getByRole('img').first(), 'the altitude');
    await fresh.page.waitForTimeout(3000);
    kB.push(loaded / 1e3);
    await fresh.context.close();
  }
  tell('flight_opens_first', 'ms', ms.splice(0, 1), 1500);
  tell('flight_opens', 'ms', ms, 1500);
  tell('flight_loads', 'kB', kB, 4000);
});

await step(page, 'memory', async () => {
  await page.goto(url);
  const memoryMB = async () => {
    const pss = (id) => Number(/^Pss:\s+(\d+)/m.exec(readFileSync(`/proc/${id}/smaps_rollup`, 'utf8'))[1]) * 1.024e-3;
    return Math.max(...(await processes()).filter(({ type }) => type === 'renderer').map(({ id }) => pss(id)));
  };
  await page.waitForTimeout(60_000);
  const minutes = Number(process.env.PLUMBLINE_MINUTES ?? 1);
  const before = await memoryMB();
  await page.waitForTimeout(minutes * 60_000);
  tell('memory', 'MB', [await memoryMB()], 200, { minutes_before: minutes, before: Math.round(before) });
  assert(errors.length === 0, errors.join('\n'));
});

await context.close();
await browser.close();
end();
