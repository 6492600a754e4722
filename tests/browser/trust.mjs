// Can what the page shows be trusted, and does it do what was meant? On a slowed-down processor where that matters.

import { armed, assert, complaints, end, holdUntil, launch, listen, liveAfter, median, number, shot, slowed, step, until, url, within } from './support.mjs';

const vehicle = listen('iris-1');
const ALTITUDE_HOLD = 3;
/** A page on a processor four times slower is live within so much, ms. */
const SLOWED_MS = 2000;

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
// The longest history there is: it must not come before the newest state.
await context.addInitScript(() => localStorage.setItem('plumbline.window_s', '120'));
const page = await context.newPage();
page.setDefaultTimeout(30_000);
// While nothing is open: what the page takes for itself gives it no more time.
const bound_ms = await within(page, 1000);
const errors = complaints(page);
let receivedB = 0;
page.on('websocket', (socket) => socket.on('framereceived', ({ payload }) => { receivedB += payload.length; }));
const on = (page) => {
  const region = (name) => page.getByRole('region', { name, exact: true });
  const button = (name) => page.getByRole('button', { name, exact: true });
  const bar = page.getByRole('banner');
  const setpoint = async () => number(await region('Setpoint').getByLabel('Altitude setpoint in use').textContent());
  const go = (name) => page.getByRole('navigation', { name: 'Pages' }).getByRole('link', { name }).click();
  return { region, button, bar, setpoint, go };
};
const { region, button, bar, setpoint, go } = on(page);
const operator = () => page.evaluate(() => ({ 'X-Plumbline-Operator': sessionStorage.getItem('plumbline.operator') }));
const reads = (metres) => until(`setpoint ${metres}`, async () => Math.abs((await setpoint()) - metres) < 1e-6);

const age = (of = page) => vehicle.age(of);

await step(page, 'live within a second of navigation, by the age of what is shown', async () => {
  await page.goto(url);
  await until('a vehicle', async () => (await age()) < 0.5);
  const ms = [];
  for (let n = 0; n < 5; n += 1) ms.push(await liveAfter(page, vehicle));
  // The best of them: a machine that tests has other things to do as well.
  assert(Math.min(...ms) <= bound_ms, `live after ${ms} ms, not within ${bound_ms} ms`);
  return { ms, median: median(ms), bound_ms };
});

let slow;
await step(page, 'nothing moves under the pointer that arms, on a processor four times slower', async () => {
  await until('checks to pass', async () => /all \d+ checks pass/.test(await region('Mode and arming').textContent()), 90_000);
  const cards = ['Setpoint', 'Mode and arming', 'Attacks', 'Estimator', 'Simulator'];
  // In their column: a script that presses a button may scroll it, which is not the page's doing.
  const place = (card) => {
    const { x, y, width, height } = card.getBoundingClientRect();
    return JSON.stringify({ x, y: y + (card.closest('.right')?.scrollTop ?? 0), width, height });
  };
  const places = () => Promise.all(cards.map((name) => region(name).evaluate(place)));
  const before = await places();
  slow = await slowed(page);
  await armed(page, 90_000);
  await page.waitForTimeout(500);
  const after = await places();
  // Armed and not yet flying it disarms itself soon; a script asks a slowed-down page many things for one press.
  await slow.end();
  cards.forEach((name, n) => assert(before[n] === after[n], `${name} moved from ${before[n]} to ${after[n]}`));
  // Armed and not yet flying: it says when it stops the motors again.
  await until('a countdown', async () => /disarms itself in \d+ s/.test(await region('Mode and arming').textContent()));
  await region('Mode and arming').locator('summary').click();
  const listed = region('Mode and arming').getByRole('listitem');
  await until('the checks while armed', async () => (await listed.count()) >= 5 && (await listed.filter({ hasText: 'recording' }).count()) === 1);
  await region('Mode and arming').locator('summary').click();
});

await step(page, 'altitude hold at 0.5 m', async () => {
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: 'Altitude hold' }).click();
  await until('the mode', () => vehicle.mode === ALTITUDE_HOLD);
  await button('Altitude 0.5 m').click();
  await reads(0.5);
});

await step(page, 'in flight a page is sent at most 100 kB a second', async () => {
  // Over seconds: a machine that stops for a moment sends afterwards what it did not send then.
  const marks = [[receivedB, performance.now()]];
  for (let n = 0; n < 3; n += 1) {
    await page.waitForTimeout(2000);
    marks.push([receivedB, performance.now()]);
  }
  const rate = ([beganB, begun], [endedB, ended]) => Math.round((endedB - beganB) / (ended - begun));
  const parts = marks.slice(1).map((mark, n) => rate(marks[n], mark));
  const kB = rate(marks[0], marks[3]);
  assert(Math.min(...parts) > 10, `${parts} kB/s: nothing is sent for a while`);
  assert(kB <= 100, `${kB} kB/s`);
  return { kB_per_s: kB };
});

// Reloads in flight; what the operator's sign of life came to. 12 and 13 are its failsafes, freeze and descent; the link's are
// not counted: ground and vehicle share this machine, and its processor.
const reloads = async (count) => {
  vehicle.failsafes.clear();
  const ms = [];
  for (let n = 0; n < count; n += 1) {
    ms.push(await liveAfter(page, vehicle));
    // Longer than the 3 s that the sign of life may stay away.
    await page.waitForTimeout(3500);
    await until('live numbers still', async () => (await age()) < 1, 10_000);
  }
  assert(vehicle.mode === ALTITUDE_HOLD && vehicle.armed, JSON.stringify({ ...vehicle, failsafes: [...vehicle.failsafes] }));
  assert(!vehicle.failsafes.has(13), 'a reload lands the vehicle');
  assert(/you control/.test(await bar.textContent()), 'control was lost');
  return { ms, median: median(ms), frozen: vehicle.failsafes.has(12) };
};

await step(page, 'reloads in flight: live within a second, and the operator stays', async () => {
  const seen = await reloads(3);
  assert(!seen.frozen, "the operator's sign of life was missed");
  assert(Math.min(...seen.ms) <= bound_ms, `live after ${seen.ms} ms, not within ${bound_ms} ms`);
  return { ...seen, bound_ms };
});

await step(page, 'reloads in flight on a processor four times slower: nothing lands, control stays', async () => {
  // It stays so slow for what follows.
  slow = await slowed(page);
  const seen = await reloads(5);
  assert(Math.min(...seen.ms) <= SLOWED_MS, `live after ${seen.ms} ms, not within ${SLOWED_MS} ms`);
  // Whether a sign of life was missed is told: what else the machine does decides it.
  return { ...seen, bound_ms: SLOWED_MS, rate: slow.rate, sum_ms: slow.sum_ms };
});

await step(page, 'three presses are three steps, from the last target and on the grid', async () => {
  await page.getByRole('heading', { name: 'Residuals' }).click();
  const from = await setpoint();
  for (let n = 0; n < 3; n += 1) {
    await page.keyboard.press('ArrowUp');
    await page.waitForTimeout(150);
  }
  await reads(from + 0.3);
  // A held key is one step.
  await page.keyboard.down('ArrowDown');
  for (let n = 0; n < 10; n += 1) await page.keyboard.down('ArrowDown');
  await page.keyboard.up('ArrowDown');
  await reads(from + 0.2);
  await page.waitForTimeout(500);
  assert(Math.abs((await setpoint()) - from - 0.2) < 1e-6, `${await setpoint()}`);
  await page.getByLabel('Exact altitude in metres').fill('0.83');
  await region('Setpoint').getByRole('button', { name: 'Set', exact: true }).click();
  await reads(0.83);
  await page.getByRole('heading', { name: 'Residuals' }).click();
  await page.keyboard.press('ArrowUp');
  await reads(0.9);
});

const LATE_MS = 700;
/** Presses keys and whatever `more` does while the first setpoint is held up on its way, as a busy browser does; what was sent. */
const heldUp = async (keys, settle, more = async () => {}) => {
  const sent = [];
  const orders = /\/vehicles\/iris-1\/(setpoint|cut)$/;
  await page.route(orders, async (route) => {
    sent.push(orders.exec(route.request().url())[1]);
    if (sent.length > 1) return route.continue();
    await page.waitForTimeout(LATE_MS);
    return settle(route);
  });
  await page.getByRole('heading', { name: 'Residuals' }).click();
  for (const key of keys) await page.keyboard.press(key);
  await more();
  await page.waitForTimeout(LATE_MS + 500);
  await page.unroute(orders);
  return sent;
};

await step(page, 'what is asked later comes later, however long the browser holds up the first', async () => {
  const from = await setpoint();
  const sent = await heldUp(['ArrowDown', 'ArrowDown'], (route) => route.continue());
  await reads(from - 0.2);
  assert(sent.length === 2, `sent: ${sent}`);
  await button('Altitude up 0.1 m').click({ clickCount: 2 });
  await reads(from);
});

await step(page, 'an estimator is chosen, then applied; arrow keys act once', async () => {
  const list = page.getByLabel('Estimator in the loop');
  const before = await setpoint();
  const inLoop = await list.inputValue();
  await list.focus();
  await page.keyboard.press('ArrowDown');
  await page.keyboard.press('ArrowDown');
  await page.keyboard.press('ArrowUp');
  const chosen = await list.inputValue();
  assert(chosen !== inLoop, 'the list did not take the keys');
  await page.waitForTimeout(600);
  assert(Math.abs((await setpoint()) - before) < 1e-6, 'the setpoint moved as well');
  const unfit = list.locator('option', { hasText: 'no altitude' });
  assert((await unfit.count()) >= 1 && (await unfit.first().isDisabled()), 'an estimator without altitude can be chosen');
  // Whoever asks past the page is refused by the vehicle.
  const answer = await page.request.post(`${url}/api/v1/vehicles/iris-1/estimator`, { data: { estimator: 'vqf' }, headers: await operator() });
  assert(answer.status() === 409 && /altitude/.test(await answer.text()), `${answer.status()}: ${await answer.text()}`);
  const readouts = () => page.evaluate(() => document.activeElement.tagName);
  await list.selectOption({ label: 'UKF' });
  await region('Estimator').getByRole('button', { name: 'Apply estimator' }).click();
  await page.getByText(/Estimator UKF/).first().waitFor();
  assert((await readouts()) === 'BODY', `the focus stays on ${await readouts()}`);
  await page.keyboard.press('ArrowDown');
  await reads(0.8);
  await list.selectOption(inLoop);
  await region('Estimator').getByRole('button', { name: 'Apply estimator' }).click();
});

await step(page, 'a draft of attacks is neither impossible nor lost', async () => {
  const form = page.getByRole('form', { name: 'New attack' });
  await form.getByLabel('sensor').selectOption({ label: 'IMU 1' });
  await form.getByLabel('kind').selectOption({ label: 'bias' });
  const channels = await form.getByLabel('channel').locator('option').allTextContents();
  assert(!channels.includes('all channels') && channels.includes('gyro x'), `${channels}`);
  await form.getByLabel('kind').selectOption({ label: 'freeze' });
  assert((await form.getByLabel('channel').locator('option').allTextContents()).includes('all channels'), 'freeze covers all');
  await form.getByLabel('kind').selectOption({ label: 'bias' });
  await form.getByLabel('channel').selectOption({ label: 'gyro x' });
  // Above what the vehicle says it allows: refused beside the form, and no draft.
  const items = region('Attacks').getByRole('listitem');
  const before = await items.count();
  await form.getByLabel(/^magnitude/).fill('99.5');
  await form.getByRole('button', { name: 'Add' }).click();
  await form.getByText("magnitude: 99.5 rad/s beyond the vehicle's limit 5 rad/s").waitFor();
  assert((await items.count()) === before, 'it became a draft all the same');
  // Later than the vehicle takes, which it does not say: refused there, kept here.
  await form.getByLabel(/^magnitude/).fill('0.5');
  await form.getByLabel(/^start/).fill('700');
  await form.getByRole('button', { name: 'Add' }).click();
  await until('the draft', async () => (await items.count()) === 1);
  await button('Schedule 1 attack').click();
  await page.getByText(/Attack schedule refused/).first().waitFor();
  assert((await items.count()) === 1 && /draft/.test(await items.first().textContent()), 'the draft is gone');
  const cut = await items.first().locator('.attack-title').evaluate((e) => e.scrollWidth > e.clientWidth);
  assert(!cut, 'its name is cut');
  await shot(page, 'trust-draft-light-1280x720');
  await go('Setup');
  await go('Fly');
  await until('the draft after a visit elsewhere', async () => (await items.count()) === 1);
  await page.reload();
  await until('the draft after a reload', async () => (await items.count()) === 1);
  await button('Clear').click();
});

await step(page, 'another operator takes over: said by name, refused beside the pointer, taken back by a button', async () => {
  const guest = await context.newPage();
  await guest.addInitScript(() => sessionStorage.setItem('plumbline.operator', 'Berta 0b0b'));
  await guest.goto(url);
  const other = on(guest);
  await until('its page', async () => (await age(guest)) < 1);
  await other.bar.getByRole('button', { name: /Take over/ }).click();
  const alarm = page.getByText('Berta 0b0b took control.');
  await alarm.waitFor();
  await shot(page, 'trust-taken-light-1280x720');
  for (const [width, height] of [[820, 1180], [390, 844], [1280, 720]]) {
    await page.setViewportSize({ width, height });
    await page.waitForTimeout(300);
    const bars = await page.getByLabel('Alarms').boundingBox();
    const head = await page.getByRole('region', { name: 'Altitude chart' }).locator('header').first().boundingBox();
    const apart = bars.y + bars.height <= head.y || head.y + head.height <= bars.y;
    assert(apart && bars.height >= 26, `at ${width}×${height} the bar lies at ${JSON.stringify(bars)}, the chart's head at ${JSON.stringify(head)}`);
    await shot(page, `trust-taken-light-${width}x${height}`);
  }
  const up = button('Altitude up 0.1 m');
  const before = await setpoint();
  const box = await up.boundingBox();
  await page.mouse.click(box.x + 5, box.y + 5);
  const hint = page.getByText('Berta 0b0b controls this vehicle: take over first');
  await hint.waitFor();
  const place = await hint.boundingBox();
  const distance = Math.hypot(place.x + place.width / 2 - box.x, place.y - box.y);
  assert(distance < 200, `the reason is ${distance} px from the pointer`);
  assert((await region('Setpoint').locator('xpath=ancestor::*[@aria-disabled="true"]').count()) === 1, 'the controls do not say so');
  await page.waitForTimeout(300);
  assert(Math.abs((await setpoint()) - before) < 1e-6, 'it was done all the same');
  // Reading commands nothing: checks are listed all the same, by pointer and by keyboard.
  const checks = page.locator('details.arm-checks');
  await checks.locator('summary').click();
  await until('the checks', async () => (await checks.getByRole('listitem').count()) >= 5);
  await checks.locator('summary').press('Enter');
  await until('the checks to be folded', async () => (await checks.getAttribute('open')) === null && (await checks.getByRole('listitem').count()) === 0);
  await page.getByLabel('Alarms').getByRole('button', { name: 'Take over' }).click();
  await until('control again', async () => /you control/.test(await bar.textContent()));
  // Taken once more, and then the tab is closed: nobody controls a few seconds later.
  await other.bar.getByRole('button', { name: /Take over/ }).click();
  await alarm.waitFor();
  await guest.close();
  const begun = performance.now();
  await until('control given back', async () => !/Berta/.test(await bar.textContent()), 15_000);
  const ms = Math.round(performance.now() - begun);
  await bar.getByRole('button', { name: /Take control/ }).click();
  await until('control', async () => /you control/.test(await bar.textContent()));
  return { distance: Math.round(distance), given_back_ms: ms };
});

await step(page, 'what is old is grey, and one bar says how old', async () => {
  const viewer = await context.newPage();
  let held = false;
  await viewer.routeWebSocket(/\/live/, (socket) => {
    const ground = socket.connectToServer();
    ground.onMessage((message) => held || socket.send(message));
  });
  await viewer.goto(url);
  await until('live', async () => (await age(viewer)) < 1);
  const old = viewer.getByText(/Data is \d+ s old/);
  assert((await old.count()) === 0, 'old at first');
  held = true;
  await old.waitFor();
  // Beside other bars there is little room.
  const bars = viewer.getByRole('alert', { name: 'Alarms' });
  await bars.evaluate((bars) => { bars.style.maxWidth = '220px'; });
  assert(await old.isVisible(), 'how old it is gave way to the rest of the bar');
  await bars.evaluate((bars) => { bars.style.maxWidth = ''; });
  for (const name of ['Mode', 'Arming', 'Battery']) {
    const tag = viewer.getByRole('banner').getByLabel(name, { exact: true });
    assert(/stale/.test(await tag.getAttribute('class')), `${name} is not grey`);
  }
  assert(/stale/.test(await on(viewer).region('Readouts').getAttribute('class')), 'the readouts are not grey');
  await until('the attacks to be grey', async () => (await on(viewer).region('Attacks').locator('.schedule.stale').count()) === 1);
  assert(/stale/.test(await viewer.getByLabel('Estimator in the loop').getAttribute('class')), 'the estimator is not grey');
  await until('5 s', async () => number(await old.textContent()) >= 5);
  const real = await age(viewer);
  const said = number(await old.textContent());
  assert(Math.abs(real - said) < 1.5, `${said} s said, ${real} s old`);
  await shot(viewer, 'trust-old-light-1280x720');
  held = false;
  await old.waitFor({ state: 'detached' });
  await viewer.close();
  return { said, real };
});

await step(page, 'as fast as before', () => slow?.end());

await step(page, 'a page without charts draws nothing', async () => {
  await go('Flights');
  await page.getByRole('heading', { name: 'Flights' }).first().waitFor();
  await page.waitForTimeout(500);
  await page.evaluate(() => {
    globalThis.drawn = 0;
    for (const [real, names] of [
      [WebGL2RenderingContext.prototype, ['clear', 'clearBufferfv', 'drawArrays', 'drawElements', 'drawArraysInstanced', 'blitFramebuffer']],
      [Worker.prototype, ['postMessage']],
    ]) {
      for (const name of names) {
        const call = real[name];
        real[name] = function (...all) { globalThis.drawn += 1; return call.apply(this, all); };
      }
    }
  });
  await page.waitForTimeout(1000);
  const still = await page.evaluate(() => globalThis.drawn);
  await go('Fly');
  await until('charts again', () => page.evaluate(() => globalThis.drawn > 0));
  assert(still === 0, `${still} draws in a second`);
});

await step(page, 'the simulator gives a new battery, and makes a cut vehicle ready again', async () => {
  await button('New battery').first().click();
  const charge = async () => Number(/(\d+) %/.exec(await bar.getByLabel('Battery').textContent())?.[1]);
  await until('a full battery', async () => (await charge()) >= 98);
  // What waits behind something else is not sent behind the cut.
  const taken = { json: { command_id: 1, stage: 'accepted', reason: '' } };
  const sent = await heldUp(['ArrowUp', 'ArrowUp'], (route) => route.fulfill(taken), () => page.getByRole('button', { name: /CUT MOTORS/ }).click());
  assert(sent.join() === 'setpoint,cut', `sent: ${sent}`);
  await page.getByText('not sent, what was asked after it comes first').first().waitFor();
  await until('cut', async () => /cut/i.test(await bar.getByLabel('Mode').textContent()));
  await holdUntil('disarmed', button('Reset (hold)'), async () => /disarmed/i.test(await bar.getByLabel('Mode').textContent()));
  await armed(page, 90_000);
  await holdUntil('disarmed', button('Disarm (hold)'), () => !vehicle.armed);
});

await step(page, 'the operator has a name: kept, seen by others, and control does not go along', async () => {
  const guest = await context.newPage();
  await guest.addInitScript(() => sessionStorage.setItem('plumbline.operator', 'Berta 0b0b'));
  await guest.goto(url);
  const other = on(guest);
  await until('control', async () => /you control/.test(await bar.textContent()));
  await go('Setup');
  const field = page.getByLabel('Your name, as other operators see it');
  const rename = async (name) => {
    await field.fill(name);
    await page.keyboard.press('Tab');
  };
  const seen = async () => /others see “(.*) ([0-9a-f]{4})”/.exec(await region('Page').textContent())?.slice(1);
  const [, tab] = await until('the name that others see', seen);
  // Only what a header may carry.
  await rename('  Carla \u00d6 ');
  await until('Carla', async () => (await seen())?.join() === `Carla,${tab}`);
  await until('control given up', async () => /nobody controls/.test(await other.bar.textContent()));
  await bar.getByRole('button', { name: /Take control/ }).click();
  await until('the name in the other page', async () => (await other.bar.textContent()).includes(`Carla ${tab}`));
  await page.reload();
  await until('the same name after a reload', async () => (await seen())?.join() === `Carla,${tab}`);
  await until('control still', async () => /you control/.test(await bar.textContent()));
  await rename('');
  await until('no name', async () => (await seen())?.join() === `Operator,${tab}`);
  await guest.close();
  await go('Fly');
});

await step(page, 'the banner says what is missing, and goes by itself', async () => {
  const alone = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
  const viewer = await alone.newPage();
  let [ground, vehicles] = [true, () => []];
  await viewer.route('**/api/v1/ground', (route) => (ground ? route.continue() : route.abort()));
  await viewer.route('**/api/v1/vehicles', async (route) => {
    // A request that the end of this step cuts off is no failure.
    const answer = await route.fetch().then((real) => real.json()).catch(() => undefined);
    if (answer) await route.fulfill({ json: vehicles(answer) }).catch(() => {});
  });
  const banner = viewer.locator('.banner');
  const says = (what) => until(what, async () => (await banner.count()) === 1 && (await banner.textContent()).includes(what));
  const gone = () => until('no banner', async () => (await banner.count()) === 0);
  await viewer.goto(url);
  await says('No vehicle yet.');
  vehicles = (all) => all.map((each) => ({ ...each, connected: false }));
  await says('iris-1 is not connected.');
  vehicles = (all) => all;
  await gone();
  ground = false;
  await says('No ground station.');
  await shot(viewer, 'trust-banner-light-1280x720');
  ground = true;
  await gone();
  await alone.close();
});

await step(page, 'no complaint in the console', async () => {
  // The refused schedule.
  const refusal = errors.findIndex((text) => /status of 4(09|22)/.test(text));
  if (refusal >= 0) errors.splice(refusal, 1);
  assert(errors.length === 0, errors.join('\n'));
});

await browser.close();
end();
