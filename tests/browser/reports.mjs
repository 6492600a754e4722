// What a flight is looked into with: paths, errors, pinned cursors, tables, its report, and two flights beside each other.

import { readFileSync } from 'node:fs';

import { assert, complaints, drawn, end, launch, number, pilot, pixels, shot, shots, step, until, url } from './support.mjs';

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, acceptDownloads: true, colorScheme: 'light' });
const page = await context.newPage();
page.setDefaultTimeout(10_000);
const errors = complaints(page);
const { region, button, banner, setpoint, arm, to, disarm } = pilot(page);

await step(page, 'reports: arm and climb to 0.8 m', async () => {
  await page.goto(url);
  await arm();
  await to(0.8);
});

const form = page.getByRole('form', { name: 'Path', exact: true });
const fill = async (values) => {
  for (const [name, value] of Object.entries(values)) await form.getByLabel(new RegExp(`^${name}`)).fill(value);
};
const refused = form.getByRole('alert');

await step(page, 'paths: a wrong number is refused beside the form, by its name', async () => {
  await button('Paths').click();
  await form.getByLabel('shape').selectOption({ label: 'Heave' });
  await fill({ period: '0.2' });
  await form.getByRole('button', { name: 'Fly path' }).click();
  await until('the refusal', async () => /^period: 0.2 s is not within 1 to 3600 s/.test(await refused.textContent()));
  await fill({ period: '6' });
  await until('the refusal to go', async () => (await refused.textContent()) === '');
});

await step(page, 'paths: what the vehicle refuses is said there in plain words', async () => {
  await fill({ amplitude: '1.9', duration: '20' });
  await form.getByRole('button', { name: 'Fly path' }).click();
  const why = await until('the refusal', async () => (await refused.textContent()) || false);
  assert(/^the path (climbs at|goes up to) .* limit/.test(why), why);
  await form.getByLabel('shape').selectOption({ label: 'Circle' });
  assert(await form.getByRole('button', { name: 'Fly path' }).isDisabled(), 'a circle is offered in altitude hold');
  await form.getByText('It needs mode Hold.').waitFor();
  await shots(page, 'fly-paths');
  return { why };
});

await step(page, 'paths: a heave is flown, named, and stopped', async () => {
  await form.getByLabel('shape').selectOption({ label: 'Heave' });
  await fill({ amplitude: '0.15', period: '5', duration: '0' });
  await form.getByRole('button', { name: 'Fly path' }).click();
  const seen = [];
  await until('the setpoint to go up and down', async () => {
    seen.push(await setpoint());
    return Math.max(...seen) > 0.9 && Math.min(...seen) < 0.7;
  });
  await button('Path: heave').waitFor();
  await form.getByRole('button', { name: 'Stop' }).click();
  await until('the path to end', async () => form.getByRole('button', { name: 'Stop' }).isDisabled());
  return { least: Math.min(...seen), most: Math.max(...seen) };
});

await step(page, 'paths: a list of altitudes makes steps', async () => {
  await form.getByLabel('shape').selectOption({ label: 'Altitude list' });
  await fill({ altitudes: '0.6, 0.9', 'time at each': '4' });
  await form.getByRole('button', { name: 'Fly path' }).click();
  await until('0.9 m', async () => Math.abs((await setpoint()) - 0.9) < 1e-6);
  await until('the path to end', async () => form.getByRole('button', { name: 'Stop' }).isDisabled());
  await button('Paths').click();
});

const overlaps = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;

await step(page, 'errors: every estimator minus truth in mm and mrad, with its RMS', async () => {
  await button('Errors').first().click();
  const card = region('Errors');
  await card.getByText(/estimate minus truth/).waitFor();
  const seen = [];
  for (const plot of await card.getByRole('img').all()) seen.push(await drawn(page, plot, await plot.getAttribute('aria-label')));
  assert(seen.length === 2, `${seen.length} plots`);
  const lines = () => card.getByRole('listitem').allTextContents();
  // The estimator in the loop alone, the others folded until they are wanted.
  const folded = await lines();
  assert(folded.length === 4 && folded.filter((text) => /estimators/.test(text)).length === 2, folded.join());
  await card.getByRole('button', { name: /estimators/ }).first().click();
  await card.getByRole('heading', { name: /RMS mm/ }).waitFor();
  const told = await until('an RMS for each', async () => {
    const texts = (await lines()).filter((text) => !/estimators/.test(text));
    return texts.length >= 6 && texts.every((text) => /\d+\.\d$/.test(text)) ? texts : false;
  });
  const own = number(/(\d+\.\d)$/.exec(told[0])[1]);
  assert(own > 0 && own < 500, `the estimator in the loop is off by ${own} mm`);
  await card.getByLabel('Axis of the attitude errors').selectOption('yaw');
  await until('yaw', async () => (await card.getByLabel('Axis of the attitude errors').inputValue()) === 'yaw');
  await card.getByLabel('Axis of the attitude errors').selectOption('roll');
  await shots(page, 'fly-errors');
  await card.getByRole('button', { name: /estimators/ }).first().click();
  return { told };
});

await step(page, 'every axis has three ticks or more, and a unit', async () => {
  await page.getByText('Motors and tick time').click();
  await page.waitForTimeout(600);
  const axes = await page.locator('.plot-frame').evaluateAll((frames) => frames.filter((f) => f.getBoundingClientRect().height > 0).map((f) => ({
    name: f.querySelector('.plot').getAttribute('aria-label'),
    values: f.classList.contains('no-values') ? 3 : f.querySelectorAll('.y-labels span').length,
    times: f.querySelectorAll('.x-labels > span').length,
    unit: f.classList.contains('no-values') ? '-' : f.querySelector('.axis-unit').textContent,
    clock: f.querySelector('.x-labels').textContent.includes('min'),
  })));
  for (const axis of axes) {
    assert(axis.values >= 3 && axis.times >= 3 && axis.unit && axis.clock, JSON.stringify(axis));
  }
  assert(axes.length >= 6, `only ${axes.length} charts`);
  await page.getByText('Motors and tick time').click();
  return { axes: axes.length };
});

const cursors = region('Cursors');
const rows = async () => {
  const found = {};
  const bodies = await cursors.locator('tbody').all();
  for (const body of bodies) {
    const [name] = await body.locator('th').allTextContents();
    found[name.trim()] = (await body.locator('td').allTextContents()).map(number);
  }
  return found;
};

await step(page, 'cursors: two that stay, and what lies between them, beside the charts', async () => {
  await button('Pause charts').click();
  await button('Cursors').click();
  const altitude = region('Altitude chart').getByRole('img').first();
  const box = await altitude.boundingBox();
  await page.mouse.click(box.x + 0.4 * box.width, box.y + box.height / 2);
  const delta = async () => number(await cursors.getByLabel('Time between the cursors').textContent());
  const length = Number(await page.getByLabel('Time window').inputValue());
  const between = await until('the nearer one to move', async () => Math.abs((await delta()) - 0.35 * length) < 0.02 * length ? delta() : false);
  const found = await until('means', async () => {
    const found = await rows();
    return Number.isFinite(found['setpoint m']?.[1]) ? found : false;
  });
  const [change, mean, rms] = found['setpoint m'];
  assert(mean > 0.3 && mean < 1.2 && rms >= mean - 1e-3 && Math.abs(change) < 1, JSON.stringify(found));
  const card = await cursors.boundingBox();
  for (const plot of await page.locator('.plot').all()) {
    const place = await plot.boundingBox();
    assert(!place || !overlaps(card, place), `the card lies on ${await plot.getAttribute('aria-label')}`);
  }
  await cursors.getByLabel('Chart whose curves are measured').selectOption('Altitude error');
  await until('errors between', async () => Object.keys(await rows()).some((name) => name.includes('mm')));
  await shots(page, 'fly-cursors');
  const field = cursors.getByLabel('Time of cursor B, in seconds of the flight');
  await field.fill(String(number(await cursors.getByLabel('Time of cursor A, in seconds of the flight').inputValue()) + 2));
  await field.press('Tab');
  await until('two seconds', async () => Math.abs((await delta()) - 2) < 1e-3);
  return { between };
});

await step(page, 'charts: a drag pans, with Shift it chooses values, a double-click leads back', async () => {
  const altitude = region('Altitude chart');
  const plot = altitude.getByRole('img').first();
  const box = await plot.boundingBox();
  const at = (x, y) => [box.x + x * box.width, box.y + y * box.height];
  const drag = async (from, to) => {
    await page.mouse.move(...at(...from));
    await page.mouse.down();
    await page.mouse.move(...at((from[0] + to[0]) / 2, (from[1] + to[1]) / 2));
    await page.mouse.move(...at(...to));
    await page.mouse.up();
  };
  const ticks = (side) => altitude.locator(`${side} > span`).allTextContents();
  const [times, values] = [await ticks('.x-labels'), await ticks('.y-labels')];
  const length = Number(await page.getByLabel('Time window').inputValue());
  await drag([0.3, 0.5], [0.7, 0.5]);
  const zoom = await until('the stretch', async () => number(await altitude.getByRole('button', { name: /zoom .* s/ }).textContent()));
  assert(Math.abs(zoom - length) < 0.2, `it shows ${zoom} s, not ${length}`);
  await until('other times', async () => JSON.stringify(await ticks('.x-labels')) !== JSON.stringify(times));
  await page.keyboard.down('Shift');
  await drag([0.5, 0.3], [0.5, 0.6]);
  await page.keyboard.up('Shift');
  const chosen = await until('other values', async () => {
    const now = await ticks('.y-labels');
    return JSON.stringify(now) !== JSON.stringify(values) && now;
  });
  assert(chosen.length >= 3, `only ${chosen}`);
  // The same time is at the same place on the lanes above and on every chart below.
  const lefts = await page.locator('.centre .plot, .lane ul').evaluateAll((all) => all.map((e) => e.getBoundingClientRect()).filter((r) => r.height > 0).map((r) => [Math.round(r.left), Math.round(r.right)].join()));
  assert(lefts.length >= 7 && new Set(lefts).size === 1, lefts.join(' '));
  await page.mouse.dblclick(...at(0.5, 0.5));
  await until('back', async () => JSON.stringify(await ticks('.y-labels')) === JSON.stringify(values) || (await altitude.getByRole('button', { name: /zoom/ }).count()) === 0);
  const lanes = region('Timeline');
  const told = await lanes.getByRole('listitem').allTextContents();
  assert(told.includes('Altitude hold') && told.some((text) => /Secure \(lanes\)/.test(text)) && told.includes('0.80 m'), told.join());
  return { zoom, chosen, told };
});

const save = async (press) => {
  const [file] = await Promise.all([page.waitForEvent('download'), press()]);
  return file.path();
};

await step(page, 'a chart goes along as CSV: what is visible, a column per curve', async () => {
  const file = await save(() => button('Altitude: what is visible as CSV').click());
  const lines = readFileSync(file, 'utf8').trimEnd().split('\n');
  const heads = lines[0].split(',');
  assert(heads[0] === 'time_s' && heads.includes('setpoint m') && heads.includes('truth m'), lines[0]);
  assert(lines.every((line) => line.split(',').length === heads.length), 'ragged rows');
  const times = lines.slice(1).map((line) => Number(line.split(',')[0]));
  const length = Number(await page.getByLabel('Time window').inputValue());
  const span = times.at(-1) - times[0];
  assert(times.length > 100 && span <= length + 1e-6 && span > 0.5 * length, `${times.length} rows over ${span} s`);
  const svg = readFileSync(await save(() => button('Altitude: what is visible as SVG').click()), 'utf8');
  assert(svg.startsWith('<svg xmlns=') && svg.includes('>setpoint<') && !/var\(|style=|href/.test(svg), svg.slice(0, 300));
  const png = readFileSync(await save(() => button('Altitude: what is visible as PNG').click()));
  const [wide, high] = [png.readUInt32BE(16), png.readUInt32BE(20)];
  assert(png.subarray(1, 4).toString() === 'PNG' && wide > 2000 && high > 500 && png.length > 10_000, `${wide}×${high}, ${png.length} bytes`);
  const picture = await context.newPage();
  await picture.setContent(svg);
  assert((await picture.locator('svg path.line').count()) >= 3, 'no curves in it');
  await shot(picture, 'chart-alone');
  await picture.close();
  // What the legend points at stays, the rest of its chart steps back.
  const altitude = region('Altitude chart');
  const blue = async () => (await pixels(page, altitude.getByRole('img').first())).blue;
  const before = await blue();
  await altitude.getByRole('button', { name: 'setpoint', exact: true }).hover();
  await until('the estimate to step back', async () => (await blue()) < 0.5 * before);
  await page.mouse.move(1, 1);
  await until('the estimate to be back', async () => (await blue()) > 0.8 * before);
  await button('Take the cursors away').click();
  await button('Pause charts').click();
  await button('Errors').first().click();
  return { rows: times.length, columns: heads.length };
});

await step(page, 'reports: an attack, more steps, landed', async () => {
  const attack = page.getByRole('form', { name: 'New attack' });
  await attack.getByLabel('sensor').selectOption({ label: 'height 2' });
  await attack.getByLabel('kind').selectOption({ label: 'bias' });
  await attack.getByLabel(/^magnitude/).fill('0.5');
  await attack.getByLabel(/^start/).fill('1');
  await attack.getByLabel(/^duration/).fill('6');
  const phase = async (phases) => until(`the attack: ${phases}`, async () => phases.exec(await region('Attacks').getByRole('listitem').first().textContent())?.[0], 30_000);
  // A vehicle aborts it when it hears nothing of its ground for half a second, as where the whole machine stands still for so long:
  // whoever is at the page schedules it again.
  const ends = [];
  while (ends.at(-1) !== 'done') {
    assert(ends.length < 3, `the attack: ${ends}`);
    await attack.getByRole('button', { name: 'Add' }).click();
    await button('Schedule 1 attack').click();
    // Until then the first of the list may be an attack of before, done.
    await phase(/active/);
    ends.push(await phase(/done|aborted/));
  }
  await to(0.5);
  await to(0.8);
  await disarm();
  return { ends };
});

const listed = async () => (await (await page.request.get(`${url}/api/v1/flights`)).json()).flights;
let first;
await step(page, 'reports: the flight shows its errors', async () => {
  [first] = await until('the flight to be complete', async () => {
    const flights = await listed();
    return flights.length && flights[0].completeness === 'complete' ? flights : false;
  });
  await page.goto(`${url}/flights/${first.id}`);
  await page.getByRole('slider', { name: /Position in the flight/ }).waitFor();
  await button('Errors').first().click();
  const card = region('Errors');
  const seen = [];
  for (const plot of await card.getByRole('img').all()) seen.push(await drawn(page, plot, await plot.getAttribute('aria-label')));
  await button('Cursors').click();
  await cursors.getByLabel('Time between the cursors').waitFor();
  await shots(page, 'flight-errors');
  return seen;
});

const report = page.locator('article.report');
const section = (name) => report.locator('section').filter({ has: page.getByRole('heading', { name, exact: true }) });

await step(page, 'the report says what happened, with figures', async () => {
  await page.getByRole('link', { name: 'Report', exact: true }).click();
  const lead = await report.locator('.lead').textContent();
  assert(/iris-1 .* flew for \d+:\d\d min with \d+ steps of altitude/.test(lead) && /height 2: bias \+0\.5 m/.test(lead), lead);
  const steps = await section('Steps').getByRole('row').allTextContents();
  assert(steps.length === first.steps.length + 2 && /mean ± σ.*\d ± \d/.test(steps.at(-1)), JSON.stringify(steps));
  const attack = (await section('Attacks').getByRole('row').all()).at(-1);
  const cells = await attack.getByRole('cell').allTextContents();
  assert(cells.length === 10 && number(cells[6]) > 0, JSON.stringify(cells));
  const ranked = await section('Estimators').getByRole('row').allTextContents();
  assert(ranked.length >= 3, JSON.stringify(ranked));
  const rms = (await section('Estimators').locator('tbody tr td:nth-child(3)').allTextContents()).map(number).filter(Number.isFinite);
  assert(rms.every((value, i) => i === 0 || value >= rms[i - 1]), `not in order: ${rms}`);
  const recording = await section('Recording').textContent();
  assert(/page\d/.test(recording) && /agent\d/.test(recording) && /ground\d/.test(recording), recording);
  assert(/seed\d/.test(await section('Configuration').textContent()), 'no seed');
  assert(/deviation of altitude/.test(await section('Controller').textContent()), 'no gains');
  assert((await report.locator('svg path.line').count()) >= 4, 'no figures');
  await shots(page, 'report');
  return { lead, ranked };
});

await step(page, 'the report prints without the page around it, and keeps as one file', async () => {
  await page.emulateMedia({ media: 'print', colorScheme: 'dark' });
  assert(!(await banner.isVisible()) && !(await button('Print').isVisible()), 'the page is printed, too');
  await shot(page, 'report-print', { fullPage: true });
  await page.emulateMedia({ media: 'screen', colorScheme: 'light' });
  const html = readFileSync(await save(() => button('Save as HTML').click()), 'utf8');
  assert(!/<script|https?:|src=|href=|url\(/.test(html), 'it needs something else');
  const alone = await context.newPage();
  await alone.setContent(html);
  assert((await alone.locator('.lead').textContent()) === (await report.locator('.lead').textContent()), 'another sentence');
  await shot(alone, 'report-alone', { fullPage: true });
  await alone.close();
  const latex = readFileSync(await save(() => button('LaTeX tables').click()), 'utf8');
  assert((latex.match(/\\toprule/g) ?? []).length === 6 && /mean \$\\pm\$ \$\\sigma\$/.test(latex), latex.slice(0, 600));
  const figure = readFileSync(await save(() => button('Figure 1 SVG').click()), 'utf8');
  assert(figure.startsWith('<svg xmlns=') && figure.includes('Altitude, m') && !/var\(/.test(figure), figure.slice(0, 300));
  await page.reload();
  await report.locator('.lead').waitFor();
  return { bytes: html.length };
});

await step(page, 'another flight, under other gains', async () => {
  await page.goto(`${url}/tune`);
  await until('a preview', async () => /certified/i.test(await region('Push').getByRole('status').textContent()));
  // Whatever is in use by now, these are others.
  await page.getByLabel('altitude, m', { exact: true }).fill('0.12');
  await page.keyboard.press('Tab');
  await until('the new preview', async () => !/\(the same\)/.test(await page.locator('body').textContent())
    && /certified/i.test(await region('Push').getByRole('status').textContent()));
  await button('Push to the vehicle').click();
  await page.waitForTimeout(1000);
  await page.getByRole('navigation', { name: 'Pages' }).getByRole('link', { name: 'Fly' }).click();
  await arm();
  await to(0.8);
  // Landed by its key, and disarmed by itself.
  await page.keyboard.press('l');
  await until('landing', async () => /land/i.test(await banner.getByLabel('Mode').textContent()));
  await until('disarmed', async () => /disarmed/i.test(await banner.getByLabel('Arming').textContent()), 40_000);
});

const ask = async (name) => {
  const what = page.getByLabel('What is compared: the altitude, or a signal by its name');
  await what.fill(name);
  await what.press('Tab');
};

await step(page, 'compare: laid together, their difference, and what was not the same', async () => {
  const flights = await until('two flights', async () => {
    const flights = await listed();
    return flights.length >= 2 && flights.every((f) => f.completeness === 'complete') ? flights : false;
  });
  await page.goto(`${url}/flights/${flights[1].id},${flights[0].id}`);
  const difference = region('Difference of altitude');
  await drawn(page, difference.getByRole('img').first(), 'the difference');
  const rms = async () => number(/(\d+\.\d)$/.exec(await difference.getByRole('listitem').first().textContent())?.[1]);
  const before = await until('its RMS', async () => (await rms()) > 0 && rms());
  // From begin to take-off may be the same time in both; but only one of them was attacked.
  await page.getByLabel('What is laid on top of each other').selectOption('first attack');
  const attack = await until('another one', async () => (await rms()) !== before && rms());
  await page.getByLabel('What is laid on top of each other').selectOption('take-off');
  await until('one more', async () => (await rms()) !== attack);
  // Within a tolerance or not, by the largest difference in view; moved by hand it is another one.
  const judged = region('Tolerance').getByRole('row').last();
  const field = page.getByLabel('Tolerance of the difference, in millimetres');
  for (const [mm, verdict] of [['5000', /pass/], ['0.01', /fail/]]) {
    await field.fill(mm);
    await field.press('Tab');
    await until(`${mm} mm: ${verdict}`, async () => verdict.test(await judged.textContent()));
  }
  // The RMS tells: the largest difference may be between two that stand still, and those stay the same when moved.
  const unmoved = await rms();
  const by = judged.getByLabel(/^Move .* by, in seconds$/);
  for (const [seconds, moved] of [['1.5', true], ['0', false]]) {
    await by.fill(seconds);
    await by.press('Tab');
    await until(`the difference of ${unmoved} mm moved by ${seconds} s`, async () => ((await rms()) !== unmoved) === moved);
  }
  await page.getByLabel('What is laid on top of each other').selectOption('step');
  await page.getByLabel('Number of the step').fill('2');
  await page.keyboard.press('Tab');
  await page.getByLabel('Number of the step').waitFor();
  const counted = (await region('Steps').getByRole('row').count()) - 1;
  assert(counted === flights[0].steps.length + flights[1].steps.length, `${counted} steps`);
  const differs = await region('Configuration and gains').getByRole('rowheader').allTextContents();
  assert(differs.includes('deviation of altitude'), JSON.stringify(differs));
  await shots(page, 'compare');
  const after = await rms();
  // Any signal instead of the altitude, in its own unit; a misspelt one is said, and an empty field is the altitude again.
  await ask('control.thrust');
  await until('no such signal', async () => /is no signal of the first flight/.test(await page.locator('#main').getByRole('alert').textContent()));
  await ask('control.thrust_n');
  const thrust = region('Difference of control.thrust_n');
  await drawn(page, thrust.getByRole('img').first(), 'the difference of thrust');
  await until('its RMS', async () => number(/(\d+\.\d+)$/.exec(await thrust.getByRole('listitem').first().textContent())?.[1]) > 0);
  assert(/minus .*/.test(await thrust.textContent()) && (await thrust.textContent()).includes('RMS N'), await thrust.textContent());
  await shots(page, 'compare-signal');
  await ask('');
  await until('the altitude again', async () => (await rms()) > 0);
  return { before, after, differs };
});

await step(page, 'compare: a signal asked for before the ground has told which there are is read when it has; the last one asked for counts', async () => {
  let held = [];
  const list = /\/api\/v1\/flights\/[^/]*\/signals$/;
  await page.route(list, (route) => (held ? held.push(route) : route.continue()));
  await page.reload();
  await region('Difference of altitude').waitFor();
  const note = page.locator('.compare .sheet-head');
  for (const name of ['control.thrust_n', 'control.setpoint.altitude_m']) {
    await ask(name);
    await note.getByText('reading…').waitFor();
  }
  // The one asked for first is answered last.
  const late = held.reverse();
  held = undefined;
  for (const route of late) {
    await route.continue();
    await page.waitForTimeout(200);
  }
  await region('Difference of control.setpoint.altitude_m').waitFor();
  await page.waitForTimeout(500);
  assert((await region('Difference of control.thrust_n').count()) === 0, 'an answer that came too late is shown');
  await page.unroute(list);
});

await step(page, 'a flight that there is not is a page that says so', async () => {
  for (const path of ['/flights/nonsense', '/flights/nonsense/report']) {
    await page.goto(url + path);
    await page.getByRole('heading', { name: 'No such flight', level: 1 }).waitFor();
    assert((await page.getByRole('link', { name: 'MCAP' }).count()) === 0, 'it offers downloads');
    await page.getByRole('link', { name: '← All flights' }).waitFor();
  }
  await shots(page, 'flight-nonsense');
});

await step(page, 'experiments: a plan is written from what the vehicle has, and counted as it is', async () => {
  await page.goto(`${url}/experiments`);
  const region = page.getByRole('region', { name: 'Plan' });
  const text = page.getByLabel('Plan, TOML');
  const counts = async (told) => until(told, async () => (await region.getByRole('status').textContent()).includes(told));
  await region.getByText('From what this vehicle has').click();
  const form = region.getByRole('form', { name: 'Plan from this vehicle' });
  await form.getByLabel('attacked').selectOption({ label: 'IMU 2' });
  await form.getByLabel('channel').selectOption({ label: 'gyro x' });
  await form.getByLabel(/^sizes/).fill('0.05 0.2 0,5');
  await form.getByLabel('harsh').check();
  await form.getByLabel('repeats').fill('4');
  // Sizes, estimators and worlds, so often each.
  await counts('12 conditions × 4 = 48 flights');
  const plan = await text.inputValue();
  for (const part of ['instance = 2', 'channel = "gyro_x"', 'values = [0.05, 0.2, 0.5]', '"datasheet", "harsh"']) {
    assert(plan.includes(part), `${part} is not in ${plan}`);
  }
  await form.getByLabel('repeats').fill('many');
  await form.getByRole('alert').filter({ hasText: 'many' }).waitFor();
  assert((await text.inputValue()) === plan, 'a wrong answer changed the plan');
  await form.getByLabel('repeats').fill('5');
  await form.getByLabel('attacked').selectOption({ label: 'nothing' });
  await counts('4 conditions × 5 = 20 flights');
  assert(await form.getByLabel(/^sizes/).isDisabled(), 'sizes are asked for of no attack');
  await shots(page, 'experiments-form');
});

let reported;
await step(page, 'experiments: a plan is counted, refused with its line, flown; its dots fill in, and one opens as a flight', async () => {
  await page.goto(`${url}/experiments`);
  await page.getByRole('heading', { name: 'Experiments', level: 1 }).waitFor();
  const plan = page.getByLabel('Plan, TOML');
  const counted = page.getByRole('region', { name: 'Plan' }).getByRole('status');
  const questions = page.getByRole('region', { name: 'Plan' }).getByRole('combobox');
  for (const question of (await questions.locator('option').allTextContents()).reverse()) {
    await plan.fill('repeats = "none"');
    await page.getByRole('region', { name: 'Plan' }).getByRole('alert').waitFor();
    await questions.selectOption(question);
    await until(`${question} counted`, async () => /\d+ flights/.test(await counted.textContent()));
  }
  const text = (await plan.inputValue()).replace(/repeats = \d+/, 'repeats = 15').replace(/values = \[0.02.*\]/, 'values = [0.1, 0.5]');
  await plan.fill(text.replace('0.1, 0.5', '0.1, "much"'));
  const refused = await page.getByRole('region', { name: 'Plan' }).getByRole('alert').textContent();
  assert(/line \d+/.test(refused) && refused.includes('much'), refused);
  await plan.fill(text);
  await until('the plan counted', async () => (await counted.textContent()).includes('60 flights'));
  await shots(page, 'experiments-plan');
  const begun = Date.now();
  await page.getByRole('button', { name: 'Start' }).click();
  const results = region('Results');
  await results.getByRole('link', { name: /Open the flight/ }).first().waitFor({ timeout: 60_000 });
  const first_s = (Date.now() - begun) / 1000;
  const measure = results.getByLabel('Measure');
  await measure.selectOption({ index: 1 });
  const options = await measure.locator('option').allTextContents();
  const flown = async () => Number(/(\d+) of 60 flights/.exec(await results.textContent())?.[1]);
  const chosen_at = await flown();
  assert(chosen_at < 60, 'all were flown before a measure could be chosen');
  await until('all flown', async () => (await results.textContent()).includes('60 of 60 flights'), 120_000);
  const took_s = (Date.now() - begun) / 1000;
  assert((await measure.inputValue()) === '1', `chosen after ${chosen_at} flights: ${options[1]}, shown: ${await measure.inputValue()}`);
  await until('a dot for each', async () => (await results.getByRole('link', { name: /Open the flight/ }).count()) === 60);
  await shots(page, 'experiments-results');
  const address = new URL(await results.getByRole('link', { name: 'Report', exact: true }).getAttribute('href'), url).href;
  await results.getByRole('link', { name: /Open the flight/ }).last().click();
  await page.waitForURL(/\/flights\/[^/]+$/, { timeout: 30_000 });
  await drawn(page, region('Altitude chart').getByRole('img').first(), 'the altitude of the flight');
  reported = address;
  return { refused, first_s, chosen_at, took_s };
});

await step(page, 'experiments: the report, without its ground, keeps its tables for LaTeX and every figure as a picture of its own', async () => {
  const html = await (await page.request.get(reported)).text();
  const alone = await context.newPage();
  await alone.setContent(html);
  const kept = async (link) => {
    const [download] = await Promise.all([alone.waitForEvent('download'), link.click()]);
    return { name: download.suggestedFilename(), text: readFileSync(await download.path(), 'utf8') };
  };
  const tables = alone.getByRole('link', { name: 'LaTeX', exact: true });
  assert((await tables.count()) >= 1, 'no table');
  const { name, text: latex } = await kept(tables.first());
  const rows = latex.split('\\midrule')[1].split('\\bottomrule')[0].trim().split('\n');
  assert(name === 'conditions.tex' && rows.length === 4 && rows.every((row) => row.endsWith('\\\\')) && !/[%_]/.test(latex.split('\n').slice(1).join('').replace(/\\[%_]/g, '')), latex.slice(0, 900));
  const figures = await alone.getByRole('figure').count();
  const pictures = [];
  for (const link of await alone.getByRole('link', { name: 'SVG', exact: true }).all()) {
    const { name, text } = await kept(link);
    const wrong = await alone.evaluate((text) => new DOMParser().parseFromString(text, 'image/svg+xml').querySelector('parsererror')?.textContent, text);
    assert(!wrong && text.includes('<style>') && !/href=|https?:(?!\/\/www\.w3\.org)/.test(text), `${name}: ${wrong ?? text.slice(0, 300)}`);
    pictures.push(name);
  }
  assert(figures >= 2 && pictures.length === figures && new Set(pictures).size === figures, `${figures} figures, ${pictures}`);
  await shot(alone, 'experiment-report');
  await alone.close();
  return { pictures, bytes: html.length };
});

await step(page, 'experiments: conditions are chosen by their levels and sorted; the address keeps it, and a flight of the list opens', async () => {
  await page.goBack();
  const results = region('Results');
  const rows = results.getByRole('table').first().getByRole('row');
  const shown = async (rowsOfFour, told) => until(told, async () => (await rows.count()) === rowsOfFour + 1 && (await results.getByRole('status').textContent()) === told);
  await shown(4, '4 conditions');
  await results.getByLabel('magnitude').selectOption('0.5');
  await shown(2, '2 of 4 conditions');
  await results.getByLabel('in_loop').selectOption('lanes');
  await shown(1, '1 of 4 conditions');
  await results.getByRole('button', { name: 'Show all' }).click();
  await shown(4, '4 conditions');
  assert((await results.getByLabel('in_loop').inputValue()) === '', 'a choice stays although all are shown');
  await results.getByLabel('magnitude').selectOption('0.1');
  const worst = results.getByRole('columnheader', { name: 'worst' });
  await worst.getByRole('button').press('Enter');
  const sorted = async () => {
    await shown(2, '2 of 4 conditions');
    await until('the greatest first', async () => (await worst.getAttribute('aria-sort')) === 'descending');
    const at = await results.getByRole('columnheader').allTextContents();
    const column = at.findIndex((text) => text.startsWith('worst'));
    const figures = await Promise.all([1, 2].map(async (row) => number(await rows.nth(row).getByRole('cell').nth(column).textContent())));
    assert(figures[0] >= figures[1], `sorted: ${figures}`);
    return figures;
  };
  const before = await sorted();
  await page.reload();
  const after = await sorted();
  assert(before.join() === after.join(), `${before} before, ${after} after a reload`);
  assert((await results.getByLabel('Measure').inputValue()) === '1', 'the measure is another one after a reload');
  await results.getByText('Flights, the worst first').click();
  const flights = results.getByRole('link', { name: /^Open flight/ });
  await until('its 30 flights', async () => (await flights.count()) === 30);
  for (const width of [820, 390]) {
    await page.setViewportSize({ width, height: 844 });
    const wide = await page.evaluate(() => document.scrollingElement.scrollWidth - innerWidth);
    assert(wide <= 0, `${wide} px wider than ${width} px`);
  }
  await page.setViewportSize({ width: 1280, height: 720 });
  await shots(page, 'experiments-browsed');
  await flights.first().click();
  await page.waitForURL(/\/flights\/[^/]+$/, { timeout: 30_000 });
  return { before };
});

await step(page, 'experiments by hand: led through a drawn order on the vehicle; accepted, void, left and gone on with', async () => {
  await page.goto(`${url}/experiments`);
  const plan = page.getByRole('region', { name: 'Plan' });
  await plan.getByRole('combobox').selectOption({ label: 'On the rig, flown by hand: which estimator holds steps?' });
  const text = page.getByLabel('Plan, TOML');
  await until('the plan', async () => /\[by_hand\]/.test(await text.inputValue()));
  const short = (await text.inputValue()).replace('repeats = 3', 'repeats = 1').replace(/altitude_m = .*/, 'altitude_m = [0.5, 0.7]')
    .replace('rest_s = 20.0', 'rest_s = 3.0');
  await text.fill(`${short}[attack]\nsensor = "height"\nkind = "bias"\nmagnitude = 0.2\nstart_s = 6.0\nduration_s = 4.0\n`);
  await until('2 flights', async () => /2 flights.*at the stick/.test(await plan.getByRole('status').textContent()));
  await button('Keep').click();
  await until('none flown', async () => /0 of 2 flights/.test(await region('Results').textContent()));
  await button('Fly the next').click();
  const led = page.getByRole('complementary', { name: 'Flight by hand' });
  const present = () => led.locator('li[aria-current="step"]').textContent();
  const at = (title) => until(title, async () => (await present()).startsWith(title), 30_000);
  const flown = async () => {
    // Where the estimator is in the loop already there is nothing to set up, and the step is over before it can be pressed.
    const press = () => led.getByRole('button', { name: 'Set up' }).click({ timeout: 1000 }).catch(() => {});
    await until('set up', async () => {
      if (/^Set up/.test(await present())) await press();
      return /^Arm/.test(await present());
    }, 30_000);
    await arm();
    await at('Fly the profile');
    await led.getByRole('button', { name: 'Fly the profile' }).click();
    await until('it flies', async () => /left/.test(await present()));
    await until('it climbs', async () => Math.abs((await setpoint()) - 0.5) < 0.01);
  };
  const land = async () => {
    await page.keyboard.press('l');
    await until('disarmed', async () => /disarmed/i.test(await banner.getByLabel('Arming').textContent()), 40_000);
    await at('Does it count?');
  };
  await flown();
  await until('the attack', async () => /active/.test(await region('Attacks').textContent()));
  await shots(page, 'by-hand');
  await at('Land');
  await land();
  await until('it can be accepted', () => led.getByRole('button', { name: 'Accept' }).isEnabled());
  await shots(page, 'by-hand-judged');
  await led.getByRole('button', { name: 'Accept' }).click();
  await until('the second', async () => /2 of 2/.test(await led.textContent()) && /last flight: accepted/.test(await led.textContent()));
  // Landed in the middle: void, with the reason that is there already. A reload loses nothing of it.
  await flown();
  await page.reload();
  await until('still flying', async () => /left/.test(await present()));
  await land();
  await until('why', async () => (await led.getByRole('textbox').inputValue()) === 'it ended before its profile did');
  await led.getByRole('button', { name: 'Void' }).click();
  await until('flown again', async () => /2 of 2/.test(await led.textContent()) && /void, it ended before/.test(await led.textContent()));
  await led.getByRole('button', { name: /^Leave/ }).click();
  await page.getByRole('navigation', { name: 'Pages' }).getByRole('link', { name: 'Experiments' }).click();
  await until('one counts', async () => /1 of 2 flights/.test(await region('Results').textContent()));
  await region('Results').getByRole('link', { name: /Open the flight/ }).first().click();
  await page.waitForURL(/\/flights\/[^/]*iris-1[^/]*$/, { timeout: 30_000 });
});

await step(page, 'reports: no complaint in the console', async () => {
  // Chromium itself writes a line for each refused request: the heave that leaves the box, and what there is not.
  const own = errors.filter((text) => !/status of 4(04|09|22)/.test(text));
  assert(own.length === 0, own.join('\n'));
});

await browser.close();
end();
