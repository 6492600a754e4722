// The everyday use through the drivers of real devices: the simulator speaks their protocols on ports of its own.

import { armed, assert, end, launch, number, shot, step, until, url } from './support.mjs';

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
const page = await context.newPage();
page.setDefaultTimeout(10_000);
const region = (name) => page.getByRole('region', { name });
const readout = async (name) => number(await region('Readouts').getByRole('definition').nth(['roll', 'pitch', 'yaw', 'altitude'].indexOf(name) * 2).textContent());
const arming = async () => page.getByRole('banner').getByLabel('Arming').textContent();
/** Setpoint by the exact field, and until the altitude has stayed near it for two seconds. */
const reach = async (metres) => {
  await page.getByLabel('Exact altitude in metres').fill(String(metres));
  await region('Setpoint').getByRole('button', { name: 'Set', exact: true }).click();
  let since = Date.now();
  await until(`two seconds at ${metres} m`, async () => {
    if (Math.abs((await readout('altitude')) - metres) > 0.05) since = Date.now();
    return Date.now() - since > 2000;
  }, 60_000);
};

await step(page, 'wires: every device gives readings, and the vehicle arms', async () => {
  await page.goto(url, { waitUntil: 'commit' });
  await armed(page, 60_000);
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: /altitude hold/i }).click();
});

await step(page, 'wires: altitude steps', async () => {
  for (const metres of [0.5, 0.8, 1.0, 0.6]) await reach(metres);
});

await step(page, 'wires: an attack on height 2 is seen, and the altitude holds', async () => {
  const form = page.getByRole('form', { name: 'New attack' });
  await form.getByLabel('sensor').selectOption({ label: 'height 2' });
  await form.getByLabel('kind').selectOption({ label: 'bias' });
  await form.getByLabel(/^magnitude/).fill('0.5');
  await form.getByLabel(/^start/).fill('1');
  await form.getByLabel(/^duration/).fill('10');
  await form.getByRole('button', { name: 'Add' }).click();
  await page.getByRole('button', { name: 'Schedule 1 attack' }).click();
  const attacks = region('Attacks');
  await until('active', async () => /active/i.test(await attacks.getByRole('listitem').first().textContent()));
  const row = region('Residuals').getByRole('listitem').filter({ has: page.getByRole('button', { name: 'Residuals of height 2' }) });
  const ratio = await until('height 2 above 1', async () => {
    const ratio = number((await row.textContent()).replace(/^\s*height 2/, ''));
    return ratio > 1 ? ratio : false;
  });
  const begun = Date.now();
  let worst = 0;
  while (Date.now() - begun < 6000) {
    worst = Math.max(worst, Math.abs((await readout('altitude')) - 0.6));
    await page.waitForTimeout(100);
  }
  await shot(page, 'wires-light-1280x720');
  // Half a metre of one height in three would be 17 cm of their mean.
  assert(worst < 0.1, `${worst} m off under attack`);
  return { ratio, worst_m: worst };
});

await step(page, 'wires: Setup shows each device with its rate', async () => {
  await page.getByRole('navigation', { name: 'Pages' }).getByRole('link', { name: 'Setup' }).click();
  const rows = region('Devices').getByRole('row');
  // Seven sensors and a voltage, below their heads.
  await until('eight devices', async () => (await rows.count()) === 9);
  const cells = await rows.filter({ hasText: 'imu4' }).getByRole('cell').allTextContents();
  assert(Math.abs(number(cells[1]) - 100) < 20, JSON.stringify(cells));
  await shot(page, 'wires-setup-light-1280x720');
  await page.getByRole('navigation', { name: 'Pages' }).getByRole('link', { name: 'Fly' }).click();
  return cells;
});

await step(page, 'wires: lands, and is disarmed', async () => {
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: /land/i }).click();
  await until('disarmed', async () => /disarmed/i.test(await arming()), 60_000);
});

end();
