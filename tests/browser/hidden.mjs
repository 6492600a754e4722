// A hidden tab: browsers slow its timers down to one a second; the vehicle must not take its operator for absent.
//
// Over the bare DevTools protocol: a page driven by Playwright always counts as visible.

import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

import { assert, end, Socket, step, until, url } from './support.mjs';

const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

const profile = mkdtempSync(join(tmpdir(), 'plumbline-hidden-'));
const browser = spawn(
  process.env.PLUMBLINE_CHROMIUM,
  ['--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--remote-debugging-port=0', `--user-data-dir=${profile}`, 'about:blank'],
  { stdio: ['ignore', 'ignore', 'pipe'] },
);
process.on('exit', () => {
  browser.kill('SIGKILL');
  try {
    rmSync(profile, { recursive: true, force: true, maxRetries: 5 });
  } catch (error) {
    // The browser's children may still be writing; the profile is in the temporary folder.
    console.error(`left behind: ${profile} (${error.code})`);
  }
});
const devtools = await new Promise((resolve) => {
  let said = '';
  browser.stderr.on('data', (text) => {
    said += text;
    const found = /DevTools listening on ws:\/\/([^/]+)\//.exec(said);
    if (found) resolve(`http://${found[1]}`);
  });
});

async function attach(target) {
  const socket = new Socket(target.webSocketDebuggerUrl);
  await new Promise((resolve) => socket.on('open', resolve));
  let last = 0;
  const waiting = new Map();
  socket.on('message', (text) => {
    const message = JSON.parse(text);
    waiting.get(message.id)?.(message.result ?? message.error);
    waiting.delete(message.id);
  });
  const send = (method, params = {}) =>
    new Promise((resolve) => {
      waiting.set(++last, resolve);
      socket.send(JSON.stringify({ id: last, method, params }));
    });
  const evaluate = async (expression) =>
    (await send('Runtime.evaluate', { expression, returnByValue: true, awaitPromise: true })).result?.value;
  return { send, evaluate };
}

const targets = await (await fetch(`${devtools}/json`)).json();
const page = await attach(targets.find((target) => target.type === 'page'));
// No screenshot of a hidden page.
const nothing = { screenshot: async () => {} };
await page.send('Page.enable');
await page.send('Page.addScriptToEvaluateOnNewDocument', {
  source: `window.answers = 0; window.beats = 0;
    const send = WebSocket.prototype.send;
    WebSocket.prototype.send = function (data) { window.answers += 1; return send.call(this, data); };
    setInterval(() => { window.beats += 1; }, 100);`,
});
await page.send('Page.navigate', { url });

const vehicle = async () => (await (await fetch(`${url}/api/v1/vehicles`)).json())[0];
const order = (method, action, body = {}) =>
  page.evaluate(`fetch('/api/v1/vehicles/iris-1/${action}', { method: '${method}', body: '${JSON.stringify(body)}',
    headers: { 'content-type': 'application/json', 'x-plumbline-operator': sessionStorage.getItem('plumbline.operator') } })
    .then((answer) => answer.status)`);
/** Timer beats and signs of life a second, over so many seconds. */
const rates = async (seconds) => {
  const read = () => page.evaluate('[beats, answers, document.visibilityState]');
  const [beats, answers] = await read();
  await sleep(seconds * 1000);
  const [beatsThen, answersThen, state] = await read();
  return { state, timer_hz: (beatsThen - beats) / seconds, answers_hz: (answersThen - answers) / seconds };
};

await step(nothing, 'the operator of an armed vehicle answers for it', async () => {
  await until('an operator name', () => page.evaluate(`sessionStorage.getItem('plumbline.operator')`));
  await until('control', async () => (await order('PUT', 'lease')) === 200);
  // What the vehicle did before may leave it swinging on its strings: it arms once it is still.
  await until('armed', async () => (await vehicle()).armed || (await order('POST', 'arm')) === 200, 90_000);
  assert((await order('POST', 'mode', { mode: 'altitude_hold' })) === 200, 'no altitude hold');
  assert((await order('POST', 'setpoint', { altitude_m: 0.5 })) === 200, 'no setpoint');
  const shown = await rates(5);
  assert(shown.state === 'visible' && shown.answers_hz > 5, JSON.stringify(shown));
  return shown;
});

await step(nothing, 'a hidden tab keeps the vehicle attended, though its timers are slowed down', async () => {
  await fetch(`${devtools}/json/new?about:blank`, { method: 'PUT' });
  await until('a hidden page', async () => (await page.evaluate('document.visibilityState')) === 'hidden');
  // Longer than the ten seconds after which an absent operator's vehicle lands.
  const hidden = await rates(12);
  assert(hidden.timer_hz < 3, `the browser does not slow timers down: ${JSON.stringify(hidden)}`);
  assert(hidden.answers_hz > 5, JSON.stringify(hidden));
  const { armed, mode } = await vehicle();
  assert(armed && mode === 'altitude_hold', JSON.stringify({ armed, mode }));
  return { ...hidden, mode };
});

await step(nothing, 'and lands it', async () => {
  assert((await order('POST', 'mode', { mode: 'land' })) === 200, 'no landing');
  await until('disarmed', async () => !(await vehicle()).armed);
});

end();
