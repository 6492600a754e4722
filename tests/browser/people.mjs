// Accounts: made on the page, signed in to by the form, guarded by a second step, ended from elsewhere.

import { createHmac } from 'node:crypto';

import { accessible, assert, end, launch, shot, step, until, url } from './support.mjs';

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 1280, height: 720 } });
const page = await context.newPage();
page.setDefaultTimeout(20_000);
const PASSWORD = 'a long enough password';
const people = page.getByRole('region', { name: 'People' });

/** The code of RFC 6238 for a secret in base 32, now. */
function code(secret) {
  const bits = [...secret].map((c) => 'ABCDEFGHIJKLMNOPQRSTUVWXYZ234567'.indexOf(c).toString(2).padStart(5, '0')).join('');
  const key = Buffer.from(bits.match(/.{8}/g).map((byte) => parseInt(byte, 2)));
  const counter = Buffer.alloc(8);
  counter.writeBigUInt64BE(BigInt(Math.floor(Date.now() / 30_000)));
  const hash = createHmac('sha1', key).update(counter).digest();
  const at = hash[19] & 15;
  return String((hash.readUInt32BE(at) & 0x7fff_ffff) % 1_000_000).padStart(6, '0');
}

async function signIn(shown = '', name = 'ann', on = page) {
  await on.getByLabel('Name').fill(name);
  await on.getByLabel('Password').fill(PASSWORD);
  if (shown) await on.getByLabel(/Code of your authenticator/).fill(shown);
  await on.getByRole('button', { name: 'Sign in' }).click();
}

const setup = async () => {
  await page.goto(`${url}/setup`);
  await people.waitFor();
};

await step(page, 'the first account is made on the page, and from then on everybody signs in', async () => {
  await setup();
  const form = people.getByRole('form', { name: 'New account' });
  await form.getByLabel('Name').fill('ann');
  await form.getByLabel('Password').fill(PASSWORD);
  await form.getByLabel('Role').selectOption('admin');
  await form.getByRole('button', { name: 'Add account' }).click();
  await page.goto(`${url}/setup`);
  await page.getByRole('button', { name: 'Sign in' }).waitFor();
  await accessible(page);
  await signIn();
  await page.waitForURL(`${url}/`);
  await setup();
  await people.getByText('127.0.0.1').waitFor();
});

let secret = '';
await step(page, 'an authenticator is set up with a code of it as its proof', async () => {
  await people.getByRole('button', { name: 'Set up an authenticator' }).click();
  await people.getByRole('img', { name: 'QR code of the secret' }).waitFor();
  secret = await people.locator('code').innerText();
  await shot(page, 'people-authenticator');
  await people.getByLabel('Code that it shows now').fill('000000');
  await people.getByRole('button', { name: 'Sign in by two steps' }).click();
  await page.getByText(/not the code that the authenticator shows now/).first().waitFor();
  await people.getByLabel('Code that it shows now').fill(code(secret));
  await people.getByRole('button', { name: 'Sign in by two steps' }).click();
  await people.getByText('You sign in with a password and a code').waitFor();
});

await step(page, 'then a password alone lets nobody in, and a code counts', async () => {
  await context.clearCookies();
  await page.goto(`${url}/login`);
  await signIn();
  await page.getByText('the code of your authenticator is needed').waitFor();
  await accessible(page);
  await signIn(code(secret));
  await page.waitForURL(`${url}/`);
});

await step(page, 'an admin makes accounts, changes their roles and removes them', async () => {
  await setup();
  const form = people.getByRole('form', { name: 'New account' });
  await form.getByLabel('Name').fill('bob');
  await form.getByLabel('Password').fill('short');
  await form.getByRole('button', { name: 'Add account' }).click();
  assert((await people.getByLabel('Role of bob').count()) === 0, 'a password of five letters was taken');
  await form.getByLabel('Password').fill(PASSWORD);
  await form.getByRole('button', { name: 'Add account' }).click();
  await people.getByLabel('Role of bob').selectOption('viewer');
  // Said beside the form; a notice would lie over it.
  await people.getByText('bob is viewer now').waitFor();
  assert((await page.locator('.notice').count()) === 0, 'a notice lies over the form');
  await shot(page, 'people');
});

const viewer = await (await browser.newContext({ viewport: { width: 1280, height: 720 } })).newPage();
viewer.setDefaultTimeout(20_000);
await step(viewer, 'a viewer sees what is refused to him, and why', async () => {
  await viewer.goto(`${url}/login`);
  await signIn('', 'bob', viewer);
  await viewer.waitForURL(`${url}/`);
  const asked = [];
  viewer.on('request', (request) => asked.push(`${request.method()} ${request.url()}`));
  for (const [path, name] of [['experiments', 'Start'], ['flights', 'Import…']]) {
    await viewer.goto(`${url}/${path}`);
    const button = viewer.getByRole('button', { name, exact: true });
    // Only the group that it stands in is disabled: it can be pressed, to hear why.
    await until('it to be offered', () => button.evaluate((b) => !b.disabled));
    await until('it to look refused', async () => Number(await button.evaluate((b) => getComputedStyle(b).opacity)) < 0.6);
    await button.click({ force: true });
    await viewer.getByRole('alert').getByText('You are signed in as viewer: it takes operator').waitFor();
  }
  await viewer.goto(`${url}/`);
  const rec = viewer.getByRole('banner').getByRole('button', { name: /Recording/ });
  await rec.click({ force: true });
  await viewer.getByRole('alert').getByText('You are signed in as viewer: it takes operator').waitFor();
  const changing = asked.filter((one) => /^(POST|PUT|DELETE) /.test(one) && !/experiments\/size$/.test(one));
  assert(changing.length === 0, changing.join('\n'));
  // None is kept here: the plan has the width, its text beside its questions.
  await viewer.goto(`${url}/experiments`);
  await viewer.getByText('None yet.').waitFor();
  const box = (of) => of.boundingBox();
  const [plan, text, form] = [await box(viewer.getByRole('region', { name: 'Plan' })), await box(viewer.getByLabel('Plan, TOML')), await box(viewer.getByLabel('Question to begin with'))];
  assert(plan.width > 1200 && text.x > form.x + form.width && text.width > 500, JSON.stringify({ plan, text, form }));
  assert(text.y + text.height <= plan.y + plan.height, JSON.stringify({ plan, text }));
  await shot(viewer, 'experiments-none-1280x720');
  await viewer.context().close();
});

await step(page, 'an admin removes an account with a hold', async () => {
  const remove = people.getByRole('row', { name: /^bob/ }).getByRole('button', { name: 'Remove' });
  const box = await remove.boundingBox();
  assert(box.width < 180, `Remove is ${box.width} px wide`);
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await until('bob to be gone', async () => (await people.getByLabel('Role of bob').count()) === 0);
  await page.mouse.up();
});

await step(page, 'ending a session ends it', async () => {
  // Two of ann's are there, one of them this page's.
  const sessions = people.getByRole('button', { name: /End the session of ann/ });
  await until('this session to be ended', async () => {
    await sessions.first().click({ timeout: 1000 }).catch(() => {});
    return page.evaluate(async () => (await (await fetch('/api/v1/session')).json()).signed_in === false);
  });
  // The page may be on its way to the form by itself.
  await page.goto(`${url}/setup`).catch(() => {});
  await page.getByRole('button', { name: 'Sign in' }).waitFor();
});

end();
