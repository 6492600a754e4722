// The moving picture of the README: a step on the real page, and another with height 2 attacked. Writes its frames beside the
// screenshots; `picture.py` makes one file of them. Run by hand against a running ground when the page has changed:
//   PLUMBLINE_URL=… PLUMBLINE_CHROMIUM=… PLUMBLINE_MODULES=… PLUMBLINE_SCREENSHOTS=DIR node tests/browser/picture.mjs

import { armed, end, launch, number, screenshots, step, until, url } from './support.mjs';

const browser = await launch();
const page = await browser.newPage({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
const region = (name) => page.getByRole('region', { name });
const banner = page.getByRole('banner');

await step(page, 'picture: a step under attack', async () => {
  await page.goto(url);
  await until('the page', () => banner.getByLabel('Battery').isVisible());
  const set = async (altitude) => {
    await page.getByLabel('Exact altitude in metres').fill(String(altitude));
    await region('Setpoint').getByRole('button', { name: 'Set', exact: true }).click();
  };
  await armed(page);
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: /altitude hold/i }).click();
  await set(0.5);
  const altitude = async () => number(await region('Readouts').getByRole('definition').nth(6).textContent());
  await until('0.5 m', async () => Math.abs((await altitude()) - 0.5) < 0.03);
  const form = page.getByRole('form', { name: 'New attack' });
  await form.getByLabel('sensor').selectOption({ label: 'height 2' });
  await form.getByLabel('kind').selectOption({ label: 'bias' });
  await form.getByLabel(/^magnitude/).fill('0.5');
  await form.getByLabel(/^start/).fill('4');
  await form.getByLabel(/^duration/).fill('8');
  await form.getByRole('button', { name: 'Add' }).click();
  const begun = Date.now();
  let frames = 0;
  const until_s = async (seconds) => {
    while (Date.now() - begun < seconds * 1000) {
      const next = begun + (frames + 1) * 333;
      await page.screenshot({ path: `${screenshots}/picture-${String(frames).padStart(3, '0')}.png` });
      frames += 1;
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, next - Date.now())));
    }
  };
  await until_s(1.5);
  await page.getByRole('button', { name: 'Schedule 1 attack' }).click();
  await until_s(6.5);
  await set(0.8);
  await until_s(15);
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: /land/i }).click();
  return { frames };
});
await browser.close();
end();
