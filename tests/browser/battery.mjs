// A battery that empties in flight, on a slowed-down processor: the page says so, the vehicle lands, and a new one flies on.

import { readFileSync } from 'node:fs';

import { assert, complaints, end, findings, launch, number, pilot, shot, slowed, step, until, url } from './support.mjs';

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
  // A failsafe keeps nobody out, in either theme.
  for (const theme of ['light', 'dark']) {
    const { grave } = await findings(page);
    assert(grave.length === 0, `${theme}: ${grave.length} findings\n${grave.slice(0, 12).join('\n')}`);
    await button('Dark theme').click();
  }
  await shot(page, 'battery-descends-light-1280x720');
  await until('it to stand, disarmed', async () => /disarmed/i.test(await banner.getByLabel('Arming').textContent()), 60_000);
  const left = await charge();
  assert(left > 1, `${left} % left`);
  return { left };
});

await step(page, 'battery: whatever a failsafe has to say is read whole, and covers no chart', async () => {
  const source = (path) => readFileSync(new URL(`../../${path}`, import.meta.url), 'utf8');
  const all = (text, pattern) => [...text.matchAll(pattern)].map(([, found]) => found);
  const reasons = all(source('agent/core/src/supervisor/monitor.rs'), /text\(format_args!\(\s*"([^"]+)"/g);
  const titles = all(source('web/src/model/names.rs'), /Failsafe::\w+ => "([^"]+)"/g);
  assert(reasons.length > 15 && titles.length > 20, `${reasons.length} reasons, ${titles.length} titles`);
  // With figures of their length, and after the longest title.
  const texts = reasons.map((reason) => ` – ${reason.replace(/\{[^}]*\}/g, '12.34')}`);
  const title = titles.toSorted((a, b) => b.length - a.length)[0];
  for (const [width, height] of [[1280, 720], [820, 1180]]) {
    await page.setViewportSize({ width, height });
    await page.getByLabel('Alarms').locator('.loud').waitFor();
    const wrong = await page.evaluate(([title, texts]) => {
      const alarm = document.querySelector('.alarm.loud');
      const chart = document.querySelector('section.altitude').getBoundingClientRect();
      const [told, reason] = [alarm.querySelector('b').firstChild, alarm.querySelector('b > span')];
      const before = [told.textContent, reason.textContent];
      const found = texts.filter((text) => {
        [told.textContent, reason.textContent] = [title, text];
        const parts = [alarm, ...alarm.querySelectorAll('b, b > span, button')];
        const box = alarm.getBoundingClientRect();
        const inside = parts.every((part) => {
          const { left, right, top, bottom } = part.getBoundingClientRect();
          return left >= box.left && right <= box.right && top >= box.top && bottom <= box.bottom && part.scrollWidth <= Math.max(part.clientWidth, part.offsetWidth);
        });
        return !(inside && box.right <= innerWidth && box.bottom <= chart.top);
      });
      [told.textContent, reason.textContent] = before;
      return found;
    }, [title, texts]);
    assert(wrong.length === 0, `at ${width}×${height}: ${wrong.join(' | ')}`);
  }
  await page.setViewportSize({ width: 1280, height: 720 });
  return { texts: texts.length };
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
