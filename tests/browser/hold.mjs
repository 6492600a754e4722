// Position hold under motion capture: the plane from above, and a position set by a click and by keyboard.

import { assert, complaints, drawn, end, launch, number, pilot, shot, shots, step, until, url } from './support.mjs';

const browser = await launch();
const page = await (await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' })).newPage();
page.setDefaultTimeout(10_000);
const errors = complaints(page);
const { region, button, arm, to } = pilot(page);
const position = region('Position');
const view = position.getByRole('img', { name: /From above/ });
/** Vehicle and setpoint as the picture says them, m: east, north of each. */
const told = async () => (await view.getAttribute('aria-label')).split(', ').map(number);
const there = (east, north) => until(`the vehicle at ${east}, ${north}`, async () => {
  const [x, y, ...goal] = await told();
  return Math.hypot(x - east, y - north) < 0.1 && Math.hypot(goal[0] - east, goal[1] - north) < 0.05;
}, 40_000);

await step(page, 'hold: the plane is shown where a position is held', async () => {
  await page.goto(url);
  await arm();
  assert((await view.count()) === 0, 'shown where none is held');
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: 'Hold', exact: true }).click();
  await view.waitFor();
  await to(1.0);
  await until('where it is', async () => (await told()).every(Number.isFinite));
});

await step(page, 'hold: a click sets the position, and the vehicle flies there', async () => {
  const { width, height } = await view.boundingBox();
  const px = Math.min(width, height);
  await view.click({ position: { x: width / 2 + px / 4, y: height / 2 - px / 8 } });
  // A quarter of the picture is half of what it shows to a side: box and room.
  const side = Number((await view.getAttribute('viewBox')).split(' ')[2]) / 2;
  await there(side / 2, side / 4);
  const goal = await told();
  const trail = await view.locator('polyline').getAttribute('points');
  assert(trail.trim().split(' ').length > 30, `the trail: ${trail}`);
  await position.scrollIntoViewIfNeeded();
  await shot(page, 'hold-light-1280x720');
  await button('Dark theme').click();
  await page.setViewportSize({ width: 820, height: 1180 });
  await position.scrollIntoViewIfNeeded();
  await shot(page, 'hold-dark-820x1180');
  await page.setViewportSize({ width: 1280, height: 720 });
  await button('Dark theme').click();
  return { goal };
});

await step(page, 'hold: the fields do the same by keyboard', async () => {
  await position.getByRole('textbox', { name: 'east' }).fill('-0.6');
  await position.getByRole('textbox', { name: 'north' }).fill('0');
  await page.keyboard.press('Enter');
  await there(-0.6, 0);
});

await step(page, 'the errors have the velocity below them, and the position from above beside them', async () => {
  await page.goto(`${url}/?show=errors`);
  const above = region('Position from above');
  const own = above.getByRole('img', { name: /From above: vehicle/ });
  await own.waitFor();
  await page.getByText('Velocity', { exact: true }).click();
  const velocity = page.getByRole('img', { name: /^Velocity along one direction/ });
  for (const way of ['up', 'east', 'north']) {
    await page.getByLabel('Direction of the velocity').selectOption(way);
    await drawn(page, velocity, `velocity ${way}`);
    const legend = page.locator('.velocity').getByRole('listitem');
    await until('estimate and truth', async () => (await legend.allTextContents()).filter((text) => /\d\.\d\d$/.test(text)).length >= 2);
  }
  await until('the attitude to make room', async () => (await region('Attitude chart').count()) === 0);
  const box = await own.boundingBox();
  const px = Math.min(box.width, box.height);
  await own.click({ position: { x: box.width / 2 + px / 8, y: box.height / 2 } });
  const east = Number((await own.getAttribute('viewBox')).split(' ')[2]) / 8;
  await there(east, 0);
  await shots(page, 'errors-velocity');
  // In a mode without a position to set the same is seen, and a click sets nothing.
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: 'Altitude hold' }).click();
  await until('no setpoint of the position', async () => (await own.getAttribute('class')).includes('settable') === false);
  const asked = [];
  page.on('request', (request) => { if (request.url().endsWith('/setpoint')) asked.push(request.postData()); });
  await own.click();
  await page.waitForTimeout(500);
  assert(asked.length === 0, asked.join());
  await page.getByRole('group', { name: 'Mode' }).getByRole('button', { name: 'Hold', exact: true }).click();
  await position.waitFor();
});

await step(page, 'hold: outside of the box nothing is set', async () => {
  await position.getByRole('textbox', { name: 'east' }).fill('9');
  await page.keyboard.press('Enter');
  await page.getByText(/Position/).filter({ hasText: /9/ }).first().waitFor();
  const [, , east] = await told();
  assert(Math.abs(east) <= 2, `east ${east}`);
  await button('Land').click();
  await until('landed', async () => /disarmed/i.test(await page.getByRole('banner').getByLabel('Arming').textContent()), 40_000);
});

await step(page, 'hold: no complaint in the console', async () => {
  // The refused position is one, on purpose.
  const others = errors.filter((text) => !text.includes('409'));
  assert(others.length === 0, others.join('\n'));
});

await browser.close();
end();
