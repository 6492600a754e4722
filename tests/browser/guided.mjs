// Calibrate with the vehicle in one's hands, from the first pose to a fit: a recording of an IMU that is turned (`turned.mjs`) is flown
// again, as the simulated vehicle hangs on strings and has no hands about it.

import { asks, assert, complaints, end, launch, shot, step, until, url } from './support.mjs';

const browser = await launch();
const page = await (await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' })).newPage();
page.setDefaultTimeout(10_000);
const errors = complaints(page);
const card = page.getByRole('region', { name: 'Guided calibration' });
const fit = page.getByRole('region', { name: 'Fit', exact: true });
const button = (name) => card.getByRole('button', { name, exact: true });
const said = () => card.getByRole('status').textContent();
const held = () => card.getByRole('listitem').filter({ hasText: ': held' }).allTextContents();
const run = (speed) => asks(page, 'POST', 'vehicles/iris-1/replay', { speed, step: 0 });
const kept = async (kind) => (await asks(page, 'GET', 'calibrations')).calibrations.find((c) => c.kind === kind);
const value = (calibration, name) => calibration.parameters.find((p) => p.name === name)?.value;

await step(page, 'guided: a sensor that sends nothing, and one without a magnetometer, are said in words', async () => {
  await page.goto(`${url}/calibrate`);
  await page.getByLabel('What', { exact: true }).selectOption({ label: 'Magnetometer' });
  // By the keyboard.
  await until('Begin to be offered', () => button('Begin').isEnabled());
  await button('Begin').focus();
  await page.keyboard.press('Enter');
  await until('that nothing comes', async () => /nothing comes from IMU 1/.test(await said()));
  await run(1);
  await until('that there is no field', async () => /IMU 1 has no magnetometer/.test(await said()));
  await run(0);
  await button('Give up').click();
  await button('Begin').waitFor();
});

await step(page, 'guided: poses fill one after the other, and a reload loses none', async () => {
  await page.getByLabel('What', { exact: true }).selectOption({ label: 'Accelerometer' });
  await button('Begin').click();
  await run(2);
  await until('three poses', async () => (await held()).length >= 3);
  await run(0);
  await until('standing still', async () => /nothing comes/.test(await said()));
  const before = await held();
  assert(before.some((text) => /nose up/.test(text)), JSON.stringify(before));
  assert(await button('Fit what was taken').isDisabled(), 'it can be fitted after three poses');
  await shot(page, 'guided-poses-light-1280x720', { fullPage: true });
  await page.reload();
  await until('the same poses', async () => JSON.stringify(await held()) === JSON.stringify(before));
  assert((await page.getByLabel('What', { exact: true }).inputValue()) === 'accelerometer', 'another kind is shown after a reload');
  return { before };
});

await step(page, 'guided: all poses are held, and the fit finds the scale and the bias that were put in', async () => {
  await run(2);
  await until('Complete', async () => /Complete/.test(await said()), 40_000);
  await run(0);
  await shot(page, 'guided-complete-light-1280x720', { fullPage: true });
  await button('Fit what was taken').click();
  await fit.getByText(/Left after the fit/).waitFor();
  await button('Begin').waitFor();
  const made = await kept('accelerometer');
  assert(made.input === 'iris-1, by hand' && made.samples >= 9, JSON.stringify([made.input, made.samples]));
  const scales = ['x', 'y', 'z'].map((axis) => 1 / value(made, `scale_${axis}`));
  [1.02, 0.99, 1.01].forEach((scale, n) => assert(Math.abs(scales[n] - scale) < 0.004, `scales ${scales}`));
  assert(value(made, 'misalignment_yz') !== undefined, 'ten poses give misalignment, too');
  return { scales };
});

await step(page, 'guided: turns are counted, and the fit finds the scale of the gyroscope by the accelerometer of before', async () => {
  await page.getByLabel('What', { exact: true }).selectOption({ label: 'Gyroscope' });
  await page.getByLabel('accelerometer calibration').selectOption({ index: 1 });
  await button('Begin').click();
  await run(2);
  await until('a turn', () => card.getByText(/[1-9] of 6 turns/).isVisible(), 20_000);
  assert(await button('Fit what was taken').isDisabled(), 'it can be fitted after a turn');
  await until('Complete', async () => /Complete/.test(await said()), 40_000);
  await run(0);
  await shot(page, 'guided-gyroscope-light-1280x720', { fullPage: true });
  await button('Fit what was taken').click();
  await until('the fit', async () => (await kept('gyroscope')) !== undefined);
  const made = await kept('gyroscope');
  const scales = ['xx', 'yy', 'zz'].map((axis) => 1 / value(made, `matrix_${axis}`));
  [1.03, 0.98, 1.01].forEach((scale, n) => assert(Math.abs(scales[n] - scale) < 0.01, `scales ${scales}`));
  [0.004, -0.003, 0.005].forEach((bias, n) => assert(Math.abs(value(made, `bias_${'xyz'[n]}`) - bias) < 0.001, JSON.stringify(made.parameters)));
  return { scales, turns: made.samples };
});

await step(page, 'guided: the sphere fills while the vehicle is turned, and the fit finds the hard iron that was put in', async () => {
  await page.getByLabel('What', { exact: true }).selectOption({ label: 'Magnetometer' });
  await button('Begin').click();
  await run(1);
  const part = /(\d+) of 12 sectors seen/;
  const seen = async () => Number(part.exec(await card.getByRole('img', { name: /^above it/ }).getAttribute('aria-label'))?.[1] ?? 0);
  await until('the first sectors', async () => (await seen()) >= 2, 30_000);
  assert(await button('Fit what was taken').isDisabled(), 'it can be fitted after a few directions');
  await shot(page, 'guided-sphere-light-1280x720', { fullPage: true });
  await until('enough of them', () => button('Fit what was taken').isEnabled(), 30_000);
  await page.emulateMedia({ colorScheme: 'dark' });
  await page.getByRole('button', { name: 'Dark theme' }).click();
  await shot(page, 'guided-sphere-dark-1280x720', { fullPage: true });
  await page.setViewportSize({ width: 390, height: 844 });
  await shot(page, 'guided-sphere-dark-390x844', { fullPage: true });
  await page.setViewportSize({ width: 1280, height: 720 });
  await button('Fit what was taken').click();
  // The fit before it is on the page until then.
  await until('the fit', async () => (await kept('magnetometer')) !== undefined);
  await shot(page, 'guided-fitted-dark-1280x720', { fullPage: true });
  // What was recorded stays as it was: the vehicle says so, and goes on without.
  await fit.getByText('A recording is flown: its samples are those of then.').waitFor();
  assert(await fit.getByRole('button', { name: 'Use on iris-1' }).isDisabled(), 'a recording can be calibrated otherwise');
  const made = await kept('magnetometer');
  const hard = ['x', 'y', 'z'].map((axis) => value(made, `hard_${axis}`));
  [4, -7, 12].forEach((put, n) => assert(Math.abs(hard[n] - put) < 1, `hard iron ${hard}`));
  return { field_ut: value(made, 'field'), hard, directions: made.samples };
});

await step(page, 'guided: no complaint in the console', async () => {
  assert(errors.length === 0, errors.join('\n'));
});

await browser.close();
end();
