// A battery that empties in flight, on a slowed-down processor: the page says so, the vehicle lands, and a new one flies on.

import { assert, complaints, end, launch, number, pilot, shot, slowed, step, until, url } from './support.mjs';

const browser = await launch();
const page = await browser.newPage({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
page.setDefaultTimeout(10_000);
const errors = complaints(page);
const { region, button, banner, arm } = pilot(page);
const alarm = (what) => page.getByLabel('Alarms').getByText(what);
const charge = async () => number(/([\d.]+) %/.exec(await banner.getByLabel('Battery').textContent())?.[1]);
const checks = () => region('Mode and arming').textContent();

let slow;
await step(page, 'battery: a vehicle flies on half a battery', async () => {
  await page.goto(url);
  await until('checks to pass', async () => /all \d+ checks pass/.test(await checks()), 60_000);
  assert((await page.getByLabel('Alarms').getByText(/Battery/).count()) === 0, 'low at once');
  slow = await slowed(page);
  await arm();
  await button('Altitude 0.5 m').click();
  return { charge: await charge(), rate: slow.rate };
});

await step(page, 'battery: low is a bar over the page before anything acts, and then a failsafe', async () => {
  await alarm(/^Battery low, [\d.]+ V · \d+ %: land now\.$/).waitFor({ timeout: 60_000 });
  const said = await charge();
  // Below 30 %, as it is rounded.
  assert(said <= 30 && said > 20, `${said} %`);
  assert(/warn|bad/.test(await banner.getByLabel('Battery', { exact: true }).getAttribute('class')), 'the toolbar does not say so');
  await alarm(/battery at \d+ % \(limit 25 %\): land soon/).waitFor({ timeout: 30_000 });
  await shot(page, 'battery-low-light-1280x720');
  return { said };
});

await step(page, 'battery: nearly empty lands by itself, with what is left', async () => {
  await alarm(/battery at \d+ % \(limit 15 %\): descending/).waitFor({ timeout: 60_000 });
  await alarm(/^[\d.]+ V$/).waitFor();
  const cut = await page.getByLabel('Alarms').locator('b').evaluateAll((all) => all.filter((b) => b.scrollWidth > b.clientWidth).map((b) => b.textContent));
  assert(cut.length === 0, `cut: ${cut.join(', ')}`);
  await shot(page, 'battery-descends-light-1280x720');
  await until('it to stand, disarmed', async () => /disarmed/i.test(await banner.getByLabel('Arming').textContent()), 60_000);
  const left = await charge();
  assert(left > 1, `${left} % left`);
  return { left };
});

await step(page, 'battery: it does not arm before it has a new one, and then flies', async () => {
  await until('the check to fail', async () => !/all \d+ checks pass/.test(await checks()));
  const failing = region('Mode and arming').locator('li.bad').filter({ hasText: /battery .*\d+ %/ });
  await region('Mode and arming').locator('summary').click();
  await failing.waitFor();
  await region('Mode and arming').locator('summary').click();
  // In its card, as beside the bar.
  await region('Simulator').getByRole('button', { name: 'New battery' }).click();
  await until('a full battery', async () => (await charge()) >= 95);
  await arm();
  await shot(page, 'battery-new-light-1280x720');
  await slow?.end();
});

await step(page, 'battery: no complaint in the console', async () => {
  assert(errors.length === 0, errors.join('\n'));
});

await browser.close();
end();
