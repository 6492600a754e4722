// What axe-core finds on every page, light and dark, wide and narrow; and what a small screen keeps within reach.

import { assert, complaints, end, findings, launch, shot, step, until, url } from './support.mjs';

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: 'light' });
const page = await context.newPage();
page.setDefaultTimeout(10_000);
const errors = complaints(page);
const { flights } = await (await page.request.get(`${url}/api/v1/flights`)).json();
const some = flights.slice(0, 2).map((flight) => flight.id);

const PAGES = {
  fly: '/', errors: '/?show=errors&velocity=1', signals: '/?show=signals', space: '/?space=1&wide=1', flights: '/flights', experiments: '/experiments', tune: '/tune', calibrate: '/calibrate', setup: '/setup',
  ...(some[0] && { flight: `/flights/${some[0]}`, report: `/flights/${some[0]}/report` }),
  ...(some[1] && { compare: `/flights/${some.join(',')}` }),
};

// Letters smaller than 12 px on the screen; in a drawing as it is scaled.
const small = () => page.evaluate(() => {
  const found = [];
  for (const element of document.body.querySelectorAll('*')) {
    const own = [...element.childNodes].filter((n) => n.nodeType === 3).map((n) => n.textContent.trim()).join(' ').trim();
    const box = element.getBoundingClientRect();
    if (!own || box.width < 2 || box.height < 2) continue;
    const scale = element instanceof SVGGraphicsElement ? element.getScreenCTM().a : 1;
    const size = parseFloat(getComputedStyle(element).fontSize) * scale;
    if (size < 11.95) found.push(`${size.toFixed(1)} px: ${element.tagName}.${element.className.baseVal ?? element.className} "${own.slice(0, 30)}"`);
  }
  return found;
});

for (const [name, path] of Object.entries(PAGES)) {
  await step(page, `axe: ${name}, light and dark, wide and narrow`, async () => {
    const told = {};
    for (const [width, height] of [[1280, 720], [390, 844]]) {
      const size = `${width}×${height}`;
      await page.setViewportSize({ width, height });
      await page.goto(url + path);
      await page.getByRole('heading', { level: 1 }).first().waitFor({ state: 'attached' });
      // Recordings take a moment.
      if (name === 'flight') await page.getByRole('slider', { name: /Position in the flight/ }).waitFor();
      await page.waitForTimeout(1200);
      const tiny = await small();
      assert(tiny.length === 0, `${size}: ${tiny.length} texts below 12 px\n${tiny.slice(0, 8).join('\n')}`);
      for (const theme of ['light', 'dark']) {
        const { grave, lesser } = await findings(page);
        await shot(page, `axe-${name}-${theme}-${width}x${height}`);
        await page.getByRole('button', { name: 'Dark theme' }).click();
        assert(grave.length === 0, `${size}, ${theme}: ${grave.length} findings\n${grave.slice(0, 12).join('\n')}`);
        told[`${size} ${theme}`] = lesser;
      }
      const wide = await page.evaluate(() => document.scrollingElement.scrollWidth - innerWidth);
      assert(wide <= 0, `${size}: ${wide} px wider than the screen`);
    }
    return told;
  });
}

await step(page, 'on a phone, landing and the cut stay within reach, wherever the page is', async () => {
  await page.setViewportSize({ width: 390, height: 844 });
  await page.goto(url);
  const dock = page.getByRole('region', { name: 'Land and cut' });
  for (const y of [0, 900]) {
    await page.evaluate((y) => scrollTo(0, y), y);
    for (const name of ['Land', 'CUT MOTORS']) {
      const button = dock.getByRole('button', { name });
      const box = await until(name, () => button.boundingBox());
      assert(box.height >= 44 && box.y + box.height <= 844, `${name}: ${JSON.stringify(box)}`);
    }
  }
});

await step(page, 'axe: no complaint in the console', async () => {
  assert(errors.length === 0, errors.join('\n'));
});

await browser.close();
end();
