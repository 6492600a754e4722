// A recording flown again, by role and label: what it knows is shown, what it does not know is not, and its time obeys.

import { assert, complaints, drawn, end, launch, number, shot, step, until, url } from './support.mjs';

const browser = await launch();
const page = await (await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' })).newPage();
page.setDefaultTimeout(10_000);
const errors = complaints(page);
const region = (name) => page.getByRole('region', { name });
const card = region('Recording flown again');
const progress = () => card.getByRole('progressbar').evaluate((bar) => bar.value);

await step(page, 'replay: the recording is named and runs', async () => {
  await page.goto(url);
  await card.getByText(/\.mcap/).waitFor();
  const before = await progress();
  await until('progress', async () => (await progress()) > before);
});

await step(page, 'replay: attitude, altitude and residuals are drawn', async () => {
  const seen = [];
  for (const name of ['Altitude', 'Attitude', 'Residuals']) {
    seen.push(await drawn(page, region(name).getByRole('img').first(), name));
  }
  await shot(page, 'replay-light-1280x720');
  return seen;
});

await step(page, 'replay: nothing is offered that a recording cannot do', async () => {
  assert((await page.getByRole('button', { name: 'Arm (hold)' }).count()) === 0, 'it can be armed');
  assert((await page.getByLabel('Exact altitude in metres').count()) === 0, 'its setpoint can be moved');
  const setpoint = region('Setpoint').getByLabel('Altitude setpoint in use');
  await until('the setpoint of then', async () => Number.isFinite(number(await setpoint.textContent())));
});

await step(page, 'replay: faster, paused, one tick and twenty', async () => {
  await card.getByLabel('Speed of the recording').selectOption('4');
  await until('4× in use', async () => (await card.getByLabel('Speed of the recording').inputValue()) === '4');
  await card.getByRole('button', { name: 'Pause recording' }).click();
  await card.getByRole('button', { name: 'Run recording' }).waitFor();
  await page.waitForTimeout(300);
  const paused = await progress();
  await page.waitForTimeout(500);
  assert((await progress()) === paused, 'it runs on while paused');
  await card.getByRole('button', { name: '+1 tick' }).click();
  await until('one tick', async () => (await progress()) > paused);
  const stepped = await progress();
  await card.getByRole('button', { name: '+20 ticks' }).click();
  await until('twenty ticks', async () => (await progress()) > stepped);
  await card.getByRole('button', { name: 'Run recording' }).click();
  await until('running', async () => (await progress()) > stepped + 0.001);
});

await step(page, 'replay: no complaint in the console', async () => {
  assert(errors.length === 0, errors.join('\n'));
});

await browser.close();
end();
