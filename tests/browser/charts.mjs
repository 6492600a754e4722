// Frames per second of eight curves at 800×500, of 100 000 and of a million samples each, measured by the page itself and
// checked by pixels: by what the page chooses here, and by WebGL2.

import { assert, complaints, end, launch, pixels, step, until, url } from './support.mjs';

const browser = await launch();
const page = await browser.newPage({ viewport: { width: 800, height: 500 } });
const errors = complaints(page);

for (const [samples, means] of [100_000, 1_000_000].flatMap((samples) => ['', '&webgl'].map((means) => [samples, means]))) {
  await step(page, `charts: 8 × ${samples} samples${means}`, async () => {
    await page.goto(`${url}/?bench&samples=${samples}${means}`);
    const text = await until('#bench-result', async () => {
      const trouble = await page.locator('#bench-error').textContent({ timeout: 100 }).catch(() => '');
      assert(!trouble, `the bench page says: ${trouble}`);
      return (await page.locator('#bench-result').textContent({ timeout: 500 }).catch(() => '')).trim();
    }, 120_000);
    const result = JSON.parse(text);
    const canvas = page.locator('canvas').first();
    const seen = await pixels(page, canvas);
    assert(seen.colours >= 8 && seen.common < 0.9, `the canvas shows ${JSON.stringify(seen)}`);
    console.log(JSON.stringify({ ...result, limit: 45, pixel_colours: seen.colours, pixel_common: Number(seen.common.toFixed(3)) }));
    assert(errors.length === 0, errors.join('\n'));
  });
}

await browser.close();
end();
