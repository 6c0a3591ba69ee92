// Compares the WebGPU pictures of <relume-viewer> with the server's frames, in Chromium on a software device.
// node .ci/viewer.mjs BROWSER SERVER KEY SIZE OVERRIDES CAPTURE...
import assert from 'node:assert';
import { readFile } from 'node:fs/promises';
import { basename } from 'node:path';
import { openBrowser, openPage } from './browser.mjs';

const [program, server, key, side, overrides, ...captures] = process.argv.slice(2);
/** PSNR limits, dB: minimum for pictures under the same light, minimum for layers, and maximum for controls (another light or exposure). */
const LEAST = 50;
const LEAST_OF_LAYERS = 35;
const MOST_OF_CONTROLS = 40;
/** Lights as a render request names them. */
const LIGHTS = { sunset: { builtin: 'sunset' }, studio: { builtin: 'studio' } };
const VIEW = { azimuth: '35', elevation: '25' };

async function ask(path, init = {}) {
    const answer = await fetch(server + path, { ...init, headers: { ...init.headers, Authorization: `Bearer ${key}` } });
    const text = await answer.text();
    assert(answer.ok, `${path}: ${answer.status} ${text}`);
    return JSON.parse(text);
}

/** Trains a capture and returns the identifier of the model. */
async function trained(capture) {
    const archive = { method: 'POST', body: await readFile(capture), headers: { 'Content-Type': 'application/octet-stream' } };
    const { id } = await ask('/v1/captures', archive);
    const body = JSON.stringify({ capture: id, preset: 'draft', overrides: JSON.parse(overrides) });
    let job = await ask('/v1/jobs', { method: 'POST', body, headers: { 'Content-Type': 'application/json' } });
    while (!['succeeded', 'failed', 'cancelled', 'rejected'].includes(job.state)) {
        await new Promise((resolve) => setTimeout(resolve, 500));
        job = await ask(`/v1/jobs/${job.id}`);
    }
    assert.equal(job.state, 'succeeded');
    return job.model;
}

/** A uniform sky with a small sun, which casts a separate shadow, as a Radiance file of 256 by 128 texels. */
function sunnySky() {
    const texel = (row, column) => (row >= 40 && row < 43 && column >= 100 && column < 103 ? [230, 200, 160, 138] : [100, 115, 140, 128]);
    const texels = Array.from({ length: 128 * 256 }, (_, i) => texel(Math.floor(i / 256), i % 256)).flat();
    return Buffer.concat([Buffer.from('#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 128 +X 256\n'), Buffer.from(texels)]);
}

/** Runs in the page: installs `window.tools`, which compares pictures. */
function prepare(key) {
    const headers = { ...(key && { Authorization: `Bearer ${key}` }), 'Content-Type': 'application/json' };
    const pixels = async (blob) => {
        const picture = await createImageBitmap(blob, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
        const context = new OffscreenCanvas(picture.width, picture.height).getContext('2d');
        context.drawImage(picture, 0, 0);
        return context.getImageData(0, 0, picture.width, picture.height).data;
    };
    window.tools = {
        /** Shows a square viewer, waits until it is ready and returns its mode. */
        async show(attributes, side) {
            const viewer = document.createElement('relume-viewer');
            viewer.apiKey = key;
            viewer.style.cssText = `position: fixed; left: 0; top: 0; width: ${side}px; height: ${side}px`;
            for (const [name, value] of Object.entries(attributes)) viewer.setAttribute(name, value);
            const ready = new Promise((resolve, reject) => {
                viewer.addEventListener('relume-ready', resolve);
                viewer.addEventListener('relume-error', ({ detail }) => reject(new Error(detail.message)));
            });
            viewer.addEventListener('relume-mode', ({ detail }) => (viewer.mode = detail));
            document.body.replaceChildren(viewer);
            await ready;
            window.viewer = viewer;
            return viewer.mode;
        },
        /** The server's frame for the camera of the viewer. */
        async frame(model, environment, side, more) {
            const { eye, target, fov } = window.viewer.camera();
            const look_at = { eye, target, fov_y_deg: fov };
            const body = JSON.stringify({ camera: { look_at }, environment, width: side, height: side, tier: 'standard', ...more });
            const answer = await fetch(`/v1/models/${model}/render`, { method: 'POST', headers, body });
            if (!answer.ok) throw new Error(await answer.text());
            return pixels(await answer.blob());
        },
        async drawn(attributes) {
            for (const [name, value] of Object.entries(attributes)) window.viewer.setAttribute(name, value);
            return pixels(await window.viewer.snapshot());
        },
        /** PSNR between two pictures over the pixels where `mask` has alpha, dB. */
        psnr(a, b, mask) {
            let [sum, count] = [0, 0];
            for (let i = 0; i < a.length; i += 4) {
                if (mask[i + 3] === 0) continue;
                for (let k = 0; k < 3; k++) sum += (a[i + k] - b[i + k]) ** 2;
                count += 3;
            }
            return 20 * Math.log10(255) - 10 * Math.log10(Math.max(sum / count, 1e-9));
        },
    };
}

/** Runs in the page: PSNR (dB) of the viewer against the server's frame under a light; for the same light and for controls with another light or exposure. */
async function underLight(model, light, side) {
    const name = light.builtin ?? light.id;
    const { drawn, frame, psnr } = window.tools;
    const white = { background: '#ffffff' };
    const truth = await frame(model, light, side, white);
    const mask = await frame(model, light, side, {});
    const at = async (attributes) => psnr(await drawn({ output: 'rgb', exposure: '0', ...white, ...attributes }), truth, mask);
    const found = {
        same: await at({ environment: name, rotation: '0' }),
        turned: await at({ environment: name, rotation: '90' }),
        other: await at({ environment: 'night', rotation: '0' }),
        brighter: await at({ environment: name, rotation: '0', exposure: '0.25' }),
    };
    const brighter = await frame(model, { ...light, exposure_ev: 0.25 }, side, white);
    found.exposed = psnr(await drawn({ exposure: '0.25' }), brighter, mask);
    await drawn({ exposure: '0' });
    return found;
}

/** Runs in the page: number of pictures drawn while nothing changes, and after one camera movement. */
async function atRest() {
    const rest = () => new Promise((resolve) => setTimeout(resolve, 300));
    const drawnBy = async (act) => {
        await rest();
        const before = window.submitted;
        act();
        await rest();
        return window.submitted - before;
    };
    const idle = await drawnBy(() => {});
    return { idle, moved: await drawnBy(() => window.viewer.setAttribute('azimuth', '36')) };
}

/** Runs in the page: the mode of the viewer after its device is lost. */
async function afterLoss() {
    const ready = new Promise((resolve) => window.viewer.addEventListener('relume-ready', resolve, { once: true }));
    window.device.destroy();
    await ready;
    return window.viewer.mode;
}

/** Runs in the page before its scripts: stores the device in `window.device` and counts submissions to its queue. */
function watch() {
    const { requestDevice } = GPUAdapter.prototype;
    GPUAdapter.prototype.requestDevice = async function (...given) {
        return (window.device = await requestDevice.apply(this, given));
    };
    const { submit } = GPUQueue.prototype;
    window.submitted = 0;
    GPUQueue.prototype.submit = function (...given) {
        window.submitted += 1;
        return submit.apply(this, given);
    };
}

/** Runs in the page: PSNR (dB) of the layers that do not depend on the light. */
async function layers(model, side) {
    const { drawn, frame, psnr } = window.tools;
    const mask = await frame(model, { builtin: 'studio' }, side, {});
    const found = {};
    const names = { albedo: 'albedo', normal: 'normal', roughness: 'roughness', metalness: 'metallic', ao: 'visibility' };
    for (const [output, name] of Object.entries(names)) {
        const background = output === 'albedo' ? '#ffffff' : 'transparent';
        const truth = await frame(model, { builtin: 'studio' }, side, { outputs: [name], background });
        found[output] = psnr(await drawn({ output, background }), truth, mask);
    }
    return found;
}

const shown = (figures) => Object.entries(figures).map(([name, db]) => `${name} ${db.toFixed(1)}`).join(', ');
const sky = await ask('/v1/environments', { method: 'POST', body: sunnySky(), headers: { 'Content-Type': 'image/vnd.radiance' } });
const lights = { ...LIGHTS, 'a small sun': { id: sky.id } };
const models = [];
for (const capture of captures) models.push({ name: basename(capture), model: await trained(capture) });
const browser = await openBrowser(program);
try {
    for (const { name, model } of models) {
        const page = await openPage(browser, `${server}/`, `(${watch})()`);
        await page.run(prepare, key);
        await page.run(() => import('/relume-viewer.js').then(() => null));
        const mode = await page.run((...given) => window.tools.show(...given), { model, environment: 'sunset', ...VIEW }, Number(side));
        assert.equal(mode, 'webgpu', 'the viewer must draw with WebGPU');
        for (const [light, spec] of Object.entries(lights)) {
            const found = await page.run(underLight, model, spec, Number(side));
            console.log(`${name}, ${light}: ${shown(found)} dB`);
            assert(found.same >= LEAST && found.exposed >= LEAST, `the viewer must reach ${LEAST} dB`);
            for (const control of ['turned', 'other', 'brighter']) assert(found[control] < MOST_OF_CONTROLS, `control failed: ${control} reaches ${MOST_OF_CONTROLS} dB`);
        }
        const found = await page.run(layers, model, Number(side));
        console.log(`${name}, layers: ${shown(found)} dB`);
        for (const layer of Object.keys(found)) assert(found[layer] >= LEAST_OF_LAYERS, `layer ${layer}: the viewer must reach ${LEAST_OF_LAYERS} dB`);
        const { idle, moved } = await page.run(atRest);
        assert(idle === 0 && moved > 0, `the viewer must draw after a camera movement and not while nothing changes: ${moved} and ${idle} pictures`);
        assert.equal(await page.run(afterLoss), 'server', 'after the loss of its device the viewer must show frames of the server');
    }
    const without = await openPage(browser, `${server}/`, 'Object.defineProperty(navigator, "gpu", { value: undefined })');
    await without.run(prepare, key);
    await without.run(() => import('/relume-viewer.js').then(() => null));
    const mode = await without.run((...given) => window.tools.show(...given), { model: models[0].model, ...VIEW }, 64);
    assert.equal(mode, 'server', 'without WebGPU the viewer must show frames of the server');
} finally {
    await browser.close();
}
