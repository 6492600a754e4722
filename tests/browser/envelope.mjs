// The attack envelope on the page: its table on Setup, its line on the arming card, and attacks that know the model, prepared into the draft.

import { assert, complaints, end, launch, number, pilot, shot, step, until, url } from './support.mjs';

const browser = await launch();
const page = await (await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' })).newPage();
page.setDefaultTimeout(20_000);
const errors = complaints(page);
const { region } = pilot(page);
const cm = (text) => (/^[\d.]+ cm$/.test(text) ? number(text) : NaN);

await step(page, 'envelope: Setup has a row for each set of sensors, and the price of one more', async () => {
  await page.goto(`${url}/setup`);
  const card = region('Attack envelope');
  const rows = card.getByRole('row').filter({ has: page.getByRole('rowheader') });
  await until('its rows', async () => (await rows.count()) >= 12, 240_000);
  const bounds = {};
  for (const row of await rows.all()) {
    const [bound, held] = await row.getByRole('cell').allTextContents();
    bounds[await row.getByRole('rowheader').textContent()] = { bound, held };
  }
  for (const one of ['height 1', 'height 2', 'height 3', 'any IMU']) {
    const m = cm(bounds[one]?.bound);
    assert(m > 0.5 && m < 10, `${one}: ${JSON.stringify(bounds[one])}`);
    assert(bounds[one].held.length > 3, `${one} is held by nothing`);
  }
  assert(cm(bounds['height 1 and height 2'].bound) > cm(bounds['height 1'].bound), JSON.stringify(bounds));
  assert(bounds['all heights'].bound === 'unbounded' && /^drifts [\d.]+ cm\/s$/.test(bounds['all heights'].held), JSON.stringify(bounds['all heights']));
  const price = async (kind) => until(`the price of one ${kind} more`, async () => {
    const text = await card.getByText(new RegExp(`^one ${kind} more: `)).textContent();
    return /: ([\d.]+) cm → ([\d.]+) cm by one height, ([\d.]+) cm → ([\d.]+) cm by one IMU$/.exec(text)?.slice(1).map(Number);
  }, 240_000);
  const [before, after] = await price('height');
  assert(after < before, `a fourth height: ${before} → ${after} cm`);
  await price('IMU');
  await card.scrollIntoViewIfNeeded();
  await shot(page, 'envelope-light-1280x720');
  return { rows: Object.keys(bounds).length, height_1: bounds['height 1'].bound, before, after };
});

await step(page, 'envelope: the arming card says the same in a line, once it is opened', async () => {
  await page.goto(url);
  const card = region('Mode and arming');
  const line = card.getByText(/^Unseen attacks, with lanes: /);
  const checks = card.locator('details.arm-checks > summary');
  await checks.click();
  const text = await until('the bounds', async () => {
    const text = await line.textContent();
    return /height 1: [\d.]+ cm; /.test(text) && text;
  }, 240_000);
  assert(/any IMU: [\d.]+ cm/.test(text) && /all heights: unbounded/.test(text), text);
  // Opened it lies over the cards below.
  await checks.click();
  return { text };
});

const attacks = region('Attacks');
const form = attacks.getByRole('form', { name: 'Prepared attack' });
const drafted = async () => (await attacks.getByRole('list').last().getByRole('listitem').allTextContents()).filter((text) => /draft/i.test(text));
/** Only these are attacked. */
const choose = async (...wanted) => {
  for (const box of await form.getByRole('checkbox').all()) {
    const name = (await box.evaluate((box) => box.parentElement.textContent)).trim();
    await box.setChecked(wanted.includes(name));
  }
};
const prepare = async (generator, duration) => {
  await form.getByLabel('generator').selectOption({ label: generator });
  await form.getByLabel(/^duration/).fill(duration);
  await form.getByRole('button', { name: 'Prepare' }).click();
  await until('the answer', async () => (await form.getByRole('button', { name: 'Prepare' }).count()) === 1, 60_000);
};
const clear = async () => {
  const button = attacks.getByRole('button', { name: 'Clear' });
  if (await button.count()) await button.click();
};

await step(page, 'envelope: the optimal attack comes into the draft, and what is expected of it', async () => {
  await clear();
  await attacks.getByText('Attacks that know the model').click();
  await choose('height 2');
  assert(await form.getByLabel(/^acceleration/).isDisabled(), 'an optimal attack has no acceleration');
  await prepare('optimal, unseen', '5');
  const [one] = await until('it in the draft', async () => (await drafted()).length === 1 && drafted());
  assert(/^height 2: bias \+0\.\d+ m, a sequence\+5 s, 5 s/.test(one), one);
  const text = await until('what is expected', async () => {
    const text = await attacks.getByText(/^With lanes in the loop an exclusion or a contradiction is expected in/).textContent();
    return /in \d+ % of flights; until then the altitude moves up to [\d.]+ cm\.$/.test(text) && text;
  }, 60_000);
  assert(number(/up to ([\d.]+) cm/.exec(text)[1]) > 1, text);
  await attacks.scrollIntoViewIfNeeded();
  await shot(page, 'envelope-draft-light-1280x720');
  return { one, text };
});

await step(page, 'envelope: along a horizontal axis two sequences of an IMU are prepared; what nothing measures is refused', async () => {
  await clear();
  await choose('imu 1');
  const pushes = form.getByLabel('pushes');
  await pushes.selectOption({ label: 'position along x' });
  await prepare('optimal, unseen', '3');
  await form.getByRole('alert').getByText(/deviation is "position", which neither motion capture nor GNSS/).waitFor();
  assert((await drafted()).length === 0, 'refused, and drafted');
  await pushes.selectOption({ label: 'roll' });
  await prepare('optimal, unseen', '3');
  const texts = await until('two in the draft', async () => (await drafted()).length === 2 && drafted());
  assert(/accel y/.test(texts[0]) && /gyro x/.test(texts[1]), texts.join());
  const said = await form.getByText(/^Moves it up to [\d.]+°: \d+ % of the bound/).textContent();
  await pushes.selectOption({ label: 'altitude' });
  return { texts, said };
});

await step(page, 'envelope: where there is no zero no attack is made up, and the page says why', async () => {
  await clear();
  await choose('height 2');
  await prepare('zero dynamics', '5');
  const none = form.getByText(/^No attack: .*(no zero|moves the vehicle)/);
  await none.waitFor();
  assert((await drafted()).length === 0, 'an attack all the same');
  const why = await none.textContent();
  await choose('height 1', 'height 2', 'height 3');
  await prepare('zero dynamics', '5');
  await until('three in the draft', async () => (await drafted()).length === 3);
  await form.getByText(/^Along the zeros of a period of/).waitFor();
  return { why, drafted: await drafted() };
});

await step(page, 'envelope: a covert motion of every sensor is taken by the vehicle; too large a one is refused with the value', async () => {
  await clear();
  await choose('height 1', 'height 2', 'height 3', 'imu 1', 'imu 2', 'imu 3', 'imu 4');
  await form.getByLabel('generator').selectOption({ label: 'covert motion' });
  await form.getByLabel(/^acceleration/).fill('99');
  await prepare('covert motion', '5');
  await form.getByRole('alert').getByText(/accel_mps2.* 99/).waitFor();
  assert((await drafted()).length === 0, 'refused, and drafted');
  await form.getByLabel(/^acceleration/).fill('0.05');
  await prepare('covert motion', '5');
  await until('seven in the draft', async () => (await drafted()).length === 7);
  assert((await drafted()).filter((text) => /^height \d: .*0\.05 m\/s²/.test(text)).length === 3, JSON.stringify(await drafted()));
  await attacks.getByRole('button', { name: 'Schedule 7 attacks' }).click();
  await until('accepted', async () => /accepted|active/i.test(await attacks.getByRole('listitem').first().textContent()));
  await attacks.getByRole('button', { name: 'Abort all' }).click();
  await until('aborted', async () => /aborted/i.test(await attacks.getByRole('listitem').first().textContent()));
});

await step(page, 'envelope: the rotors can move along, and their part is in the draft', async () => {
  await clear();
  for (const box of await form.getByRole('checkbox').all()) await box.setChecked(true);
  await prepare('covert motion', '5');
  await until('eleven in the draft', async () => (await drafted()).length === 11);
  const rotors = (await drafted()).filter((text) => /^rotor \d: bias/.test(text));
  assert(rotors.length === 4, JSON.stringify(await drafted()));
  await attacks.getByText(/^With lanes in the loop an exclusion or a contradiction is expected in \d+ % of flights; until then the altitude moves up to [\d.]+ cm\.$/).waitFor();
  await attacks.getByRole('button', { name: 'Schedule 11 attacks' }).click();
  await until('accepted', async () => /accepted|active/i.test(await attacks.getByRole('listitem').first().textContent()));
  await attacks.getByRole('button', { name: 'Abort all' }).click();
  await until('aborted', async () => /aborted/i.test(await attacks.getByRole('listitem').first().textContent()));
  return { rotors };
});

await step(page, 'envelope: no complaint in the console', async () => {
  // The acceleration that was refused.
  const others = errors.filter((text) => !/status of 4(22|00)/.test(text));
  assert(others.length === 0, others.join('\n'));
});

await browser.close();
end();
