// Drives headless Chromium over a pipe (DevTools protocol). WebGPU runs on a software device.
import { spawn } from 'node:child_process';
import { mkdtemp, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

// Without these flags headless Chromium finds no adapter, or leaves the canvas blank.
const WEBGPU = ['--enable-unsafe-webgpu', '--use-angle=swiftshader', '--enable-features=Vulkan', '--use-vulkan=swiftshader'];

/** Starts the browser `program`; `close` stops it. */
export async function openBrowser(program, flags = WEBGPU) {
    const profile = await mkdtemp(join(tmpdir(), 'relume-browser-'));
    const common = ['--headless', '--no-sandbox', '--no-first-run', '--remote-debugging-pipe', `--user-data-dir=${profile}`];
    const process = spawn(program, [...common, ...flags, 'about:blank'], { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
    const [, , , to, from] = process.stdio;
    const waiting = new Map();
    let [number, text] = [0, ''];
    from.setEncoding('utf8').on('data', (piece) => {
        const messages = (text + piece).split('\0');
        text = messages.pop();
        for (const { id, result, error } of messages.map((message) => JSON.parse(message))) {
            const asked = waiting.get(id);
            waiting.delete(id);
            if (error) asked?.reject(new Error(error.message));
            else asked?.resolve(result);
        }
    });
    process.on('exit', () => waiting.forEach(({ reject }) => reject(new Error('the browser exited'))));
    const send = (method, params = {}, sessionId) =>
        new Promise((resolve, reject) => {
            waiting.set(++number, { resolve, reject });
            to.write(`${JSON.stringify({ id: number, method, params, sessionId })}\0`);
        });
    const close = async () => {
        const ended = new Promise((resolve) => process.once('exit', resolve));
        process.kill();
        await ended;
        await rm(profile, { recursive: true, force: true, maxRetries: 5 });
    };
    return { send, close };
}

/** Opens `url` in a page of `browser`. `run(f, ...values)` calls `f` in the page and returns its result, passed as JSON. The script `before` runs first. */
export async function openPage({ send }, url, before = '') {
    const { targetId } = await send('Target.createTarget', { url: 'about:blank' });
    const { sessionId } = await send('Target.attachToTarget', { targetId, flatten: true });
    const ask = (method, params) => send(method, params, sessionId);
    await ask('Page.enable');
    if (before) await ask('Page.addScriptToEvaluateOnNewDocument', { source: before });
    await ask('Page.navigate', { url });
    const run = async (f, ...values) => {
        const expression = `(${f})(...${JSON.stringify(values)})`;
        const { result, exceptionDetails } = await ask('Runtime.evaluate', { expression, awaitPromise: true, returnByValue: true });
        if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
        return result.value;
    };
    while ((await run(() => `${location.href} ${document.readyState}`)) !== `${url} complete`) {
        await new Promise((resolve) => setTimeout(resolve, 50));
    }
    return { run };
}
