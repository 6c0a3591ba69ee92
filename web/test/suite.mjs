// node test/suite.mjs BASE KEY CAPTURE.zip LIGHT.hdr SITE PHOTOS [SHOTS]: walks through the web app in a real browser, from an upload to a download.
// Fails on an error in the console, on a violation of the Content-Security-Policy and on what axe-core finds. SITE is an origin
// that the server lists. PHOTOS is a folder of photographs without poses, for which the server's COLMAP finds none after a while. Pictures go to SHOTS.
import assert from 'node:assert/strict'
import { readdirSync, readFileSync, statSync } from 'node:fs'
import { createServer } from 'node:http'
import { createRequire } from 'node:module'
import { chromium } from 'playwright-core'
import { confidentModel, smallerExport } from './confidence.mjs'
import { delitPhotographs } from './delight.mjs'
import { documentedApi } from './documentation.mjs'
import { keyIsNotPolled, lostServer, refusedTraining, unknownPaths, wrongFiles } from './failures.mjs'
import { stagedModel } from './lamps.mjs'
import { changedMaterials } from './materials.mjs'
import { nextPhotographs } from './next-photographs.mjs'
import { sharedModel, sharedWithoutWebGpu } from './sharing.mjs'
import { calibratedModel, dimmedLight, movedCamera, openedModel, takenAway, turnedLight } from './viewing.mjs'

const [base, key, capture, light, site, photos, shots] = process.argv.slice(2)
const axe = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8')
// WebGPU in software: of the flags that are usually named, only these give an adapter and a canvas.
const FLAGS = ['--no-sandbox', '--enable-unsafe-webgpu', '--use-angle=swiftshader', '--enable-features=Vulkan', '--use-vulkan=swiftshader']
/** Refusals that the walk provokes: a browser tells them to its console. */
const PROVOKED = [401, 404, 409, 413, 422, 503, 507]

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: FLAGS })
const faults = []

/** A page that remembers what went wrong on it. */
async function open(options) {
  // Without motion: a colour on its way from one scheme to the other is no colour.
  const context = await browser.newContext({ acceptDownloads: true, reducedMotion: 'reduce', ...options })
  await context.grantPermissions(['clipboard-read', 'clipboard-write'])
  const page = await context.newPage()
  page.setDefaultTimeout(60_000)
  page.on('pageerror', (error) => faults.push(`page: ${error.message}`))
  page.on('console', (message) => {
    const isProvoked = PROVOKED.some((status) => message.text().includes(`status of ${status}`))
    if (message.type() === 'error' && !isProvoked) faults.push(`console: ${message.text()}`)
  })
  await page.addInitScript(() => {
    addEventListener('securitypolicyviolation', (event) => console.error(`policy: ${event.violatedDirective} ${event.blockedURI}`))
  })
  return page
}

/** What axe-core has against the page, in both schemes. `known` are the rules that a library breaks. */
async function audit(page, name, known = []) {
  for (const colorScheme of ['light', 'dark']) {
    await page.emulateMedia({ colorScheme })
    // By the debugger, which the page's policy does not bind.
    await page.evaluate(`${axe}; 0`)
    const found = await page.evaluate(async (known) => {
      const rules = Object.fromEntries(known.map((rule) => [rule, { enabled: false }]))
      const { violations } = await globalThis.axe.run(document, { rules, runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'] })
      return violations.map(({ id, help, nodes }) => `${id}: ${help}: ${nodes.slice(0, 3).map((node) => node.html.slice(0, 160)).join(' | ')}`)
    }, known)
    assert.deepEqual(found, [], `${name}, ${colorScheme}`)
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)
    assert.ok(wide <= 0, `${name}: ${wide} pixels wider than the window`)
    if (!shots) continue
    await page.evaluate(() => scrollTo(0, 0))
    await page.screenshot({ path: `${shots}/${name}-${colorScheme}.png` })
  }
  console.log(`${name}: accessible, light and dark`)
}

const page = await open({ viewport: { width: 1280, height: 900 } })
const go = (hash) => page.evaluate((to) => (location.hash = to), hash)
const heading = (name) => page.getByRole('heading', { level: 1, name })

// The control: a page that runs an inline script is noticed.
await page.goto(base)
await page.evaluate(() => document.body.appendChild(Object.assign(document.createElement('script'), { textContent: '1' })))
await page.waitForFunction(() => true)
await new Promise((done) => setTimeout(done, 200))
assert.ok(faults.some((fault) => fault.includes('policy')), 'a violation of the policy is noticed')
faults.length = 0

// A key is asked for once, and a wrong one again.
await page.reload()
const dialog = page.getByRole('dialog')
await dialog.waitFor()
await audit(page, 'key')
await dialog.getByLabel('API key').fill('not-this-one-but-long-enough')
await dialog.getByRole('button', { name: 'Continue' }).click()
await dialog.getByRole('alert').waitFor()
await dialog.getByLabel('API key').fill(key)
await dialog.getByRole('button', { name: 'Continue' }).click()
await dialog.waitFor({ state: 'hidden' })
await heading('Captures').waitFor()
await keyIsNotPolled(open, base)
await wrongFiles(page, photos)
await audit(page, 'captures')

// Upload: a zip in pieces, through an upload that breaks off once.
let broken = 0
await page.route('**/v1/uploads/*', (route) => {
  if (route.request().method() === 'PATCH' && broken++ === 0) return route.abort('connectionreset')
  return route.continue()
})
await page.getByLabel('Files of a capture').setInputFiles(capture)
await page.getByRole('link', { name: 'Train a model' }).waitFor()
assert.ok(broken >= 2, 'the upload went on after it broke')
faults.splice(0, faults.length, ...faults.filter((fault) => !fault.includes('ERR_CONNECTION_RESET')))
await page.getByRole('img', { name: /cameras around the subject/ }).waitFor()
await page.getByRole('img', { name: /cameras around the subject/ }).press('ArrowLeft')
const thumbnails = page.getByRole('list', { name: /photographs$/ }).getByRole('img')
await thumbnails.first().waitFor()
const withoutPixels = () => [...document.querySelectorAll('.taken img')].filter((image) => image.complete && !image.naturalWidth).length
assert.equal(await page.evaluate(withoutPixels), 0)
await audit(page, 'capture')

// The sample, which has the same content; its name is changed in place.
await go('/captures')
await page.locator('.tile img').first().waitFor()
await page.getByRole('button', { name: 'Try the sample' }).click()
await heading('Sample').waitFor()
await page.getByRole('button', { name: 'Rename' }).click()
await page.getByLabel('Name', { exact: true }).fill('Spheres')
await page.getByRole('button', { name: 'Save the name' }).click()
await heading('Spheres').waitFor()

// Photographs without poses: how far COLMAP is, then why it failed and what it said.
await go('/captures')
await heading('Captures').waitFor()
await page.getByLabel('Files of a capture').setInputFiles(readdirSync(photos).map((name) => `${photos}/${name}`))
await page.getByRole('heading', { name: 'Finding where the photographs were taken' }).waitFor()
await page.getByRole('progressbar', { name: /features that photographs share/ }).waitFor()
assert.match(await page.getByRole('heading', { level: 1 }).textContent(), /^4 photographs, /)
await page.getByText('Details: the output of COLMAP').click()
await page.getByLabel('Log of COLMAP').getByText('Matching block').waitFor()
await audit(page, 'poses')
await page.getByRole('alert').getByText('COLMAP could not find out where the photographs were taken.').waitFor()
await page.getByRole('alert').getByText('Details').click()
await page.getByRole('alert').getByText(/placed 0 of \d+ photographs/).waitFor()
await page.getByLabel('Log of COLMAP').getByText('Registering image').waitFor()
assert.equal(await page.getByRole('progressbar').count(), 0, 'it is over')
await audit(page, 'poses-failed')
await go('/captures')
await page.getByRole('heading', { name: 'Not ready' }).waitFor()
await page.getByRole('link', { name: /^4 photographs, / }).waitFor()
await page.getByRole('link', { name: 'Spheres' }).click()

// Job: a very short training, watched.
await page.getByRole('link', { name: 'Train a model' }).click()
await heading('Jobs').waitFor()
await refusedTraining(page)
await page.getByLabel('Light of the photographs').selectOption('')
await page.getByRole('radio', { name: 'A preset' }).check()
await page.getByLabel('Name (optional)').fill('Walk')
await page.getByText('Details', { exact: true }).first().click()
await page.getByLabel('Quality gate, dB').fill('1')
for (const [label, value] of [['Steps', '400'], ['Longest side, px', '64'], ['Gaussians at most', '2000']]) await page.getByLabel(label).fill(value)
await audit(page, 'jobs')
await page.getByRole('button', { name: 'Start training' }).click()
await heading('Walk').waitFor()
await page.evaluate(() => {
  globalThis.Notification = class {
    static requestPermission = async () => 'granted'
    constructor(_, { body }) {
      globalThis.notified = body
    }
  }
})
await page.getByRole('button', { name: 'Notify me when it is done' }).click()
await page.getByRole('img', { name: /^The model at step/ }).waitFor()
assert.ok(!(await page.getByText('PSNR', { exact: true }).first().isVisible()), 'figures for experts wait behind Details')
await page.getByText('Details', { exact: true }).first().click()
await page.getByRole('img', { name: /^PSNR/ }).waitFor()
await audit(page, 'training')
await page.getByRole('link', { name: 'Open the model' }).waitFor({ timeout: 120_000 })
await page.getByRole('img', { name: 'The finished model' }).waitFor()
assert.equal(await page.evaluate(() => globalThis.notified), 'Walk: succeeded')
await page.locator('.notice.good').getByText('reached').waitFor()
await page.getByRole('heading', { name: /^Quality: .* at 64 pixels$/ }).waitFor()
// The steps of a time budget have another message; their figures are shown, too.
const steps = [1, 2].map((step) => `event: progress\ndata: ${JSON.stringify({ at: '', step, total: 2, psnr: 31, loss: 0.1, message: 'planned: 2 steps at 64 px' })}\n\n`)
await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body: `${steps.join('')}event: state\ndata: {"at":"","state":"succeeded"}\n\n` }))
await page.reload()
await page.getByText('Details', { exact: true }).first().click()
await page.getByRole('img', { name: 'PSNR: 31.00 dB at step 2 of 2' }).waitFor()
await page.unroute('**/events')

// Two trainings, side by side.
await go('/jobs')
await page.getByRole('button', { name: 'Start training' }).waitFor()
await page.getByLabel('Compare Walk').check()
await page.getByRole('radio', { name: 'A preset' }).check()
await page.getByText(/The last training with this preset took/).waitFor()
await page.getByLabel('Name (optional)').fill('Refused')
await page.getByText('Details', { exact: true }).first().click()
for (const [label, value] of [['Steps', '40'], ['Longest side, px', '32'], ['Gaussians at most', '500']]) await page.getByLabel(label).fill(value)
await page.getByLabel('Quality gate, dB').fill('59')
await page.getByRole('button', { name: 'Start training' }).click()
await page.getByText('missed').waitFor({ timeout: 120_000 })
await page.getByText('rejected', { exact: true }).first().waitFor()
await go('/jobs')
await page.getByLabel('Compare Walk').check()
await page.getByLabel('Compare Refused').check()
await page.getByRole('link', { name: 'Compare the two' }).click()
await page.getByRole('row', { name: /iterations/ }).waitFor()
assert.equal(await page.getByRole('row', { name: /iterations/ }).getAttribute('class'), 'differs')
assert.equal(await page.getByRole('row', { name: /^seed/ }).count(), 0)
await page.getByLabel('Also what is the same').check()
assert.notEqual(await page.getByRole('row', { name: /^seed/ }).getAttribute('class'), 'differs')
await audit(page, 'compare')

// Model: found in the list, relit, turned, its view restored by its address.
await unknownPaths(page, base, audit)
await lostServer(page, go)
faults.splice(0, faults.length, ...faults.filter((fault) => !fault.includes('ERR_CONNECTION_REFUSED')))
await page.getByRole('link', { name: 'Walk' }).waitFor()
await page.locator('.tile img').first().waitFor()
await audit(page, 'models')
await openedModel(page, page.getByRole('link', { name: 'Walk' }))
await page.waitForFunction(() => location.hash.includes('azimuth'))
await dimmedLight(page)
await movedCamera(page)
await calibratedModel(page)
await turnedLight(page)
await takenAway(page, base)
const before = await page.evaluate(() => document.querySelector('relume-viewer').camera().azimuth)
await page.locator('relume-viewer').press('ArrowRight')
await page.waitForFunction((from) => document.querySelector('relume-viewer').camera().azimuth !== from, before)
await page.getByLabel('HDR environment map').setInputFiles(light)
await page.waitForFunction(() => /light=[0-9a-f-]{36}/.test(location.hash))
await page.waitForTimeout(600)
const turned = await page.evaluate(() => document.querySelector('relume-viewer').camera().azimuth)
const second = await page.context().newPage()
await second.addInitScript((secret) => sessionStorage.setItem('relume-api-key', secret), key)
await second.goto(page.url())
await second.waitForFunction((at) => {
  const viewer = document.querySelector('relume-viewer')
  return viewer?.camera && Math.abs(viewer.camera().azimuth - at) < 0.06
}, turned)
await second.close()
await page.getByRole('radio', { name: 'studio' }).check()
await page.getByRole('img', { name: /under the chosen light/ }).waitFor()

// Against a photograph: one that was held out, from the server; the slider by keyboard, another photograph by the list.
const list = page.getByLabel('Photograph', { exact: true })
const chosen = await list.inputValue()
assert.match(await list.locator('option:checked').textContent(), /held out/)
const photograph = (name) => page.locator('.wipe > img').and(page.getByAltText(`Photograph ${name}`, { exact: true }))
await photograph(chosen).waitFor()
assert.ok(await photograph(chosen).evaluate((image) => image.naturalWidth > 0), 'the photograph is shown')
const cut = () => page.locator('.wipe').evaluate((figure) => figure.style.getPropertyValue('--cut'))
const at = await cut()
await page.getByLabel('Before and after').press('ArrowRight')
assert.notEqual(await cut(), at, 'the slider moves by keyboard')
const other = await list.locator('option').nth(1).evaluate((option) => option.value)
await list.selectOption(other)
await photograph(other).waitFor()
assert.notEqual(other, chosen)
await page.getByText('As a command').click()
await page.getByRole('button', { name: 'Copy the command' }).click()
assert.match(await page.evaluate(() => navigator.clipboard.readText()), /curl .*\/v1\/models\//s)
await audit(page, 'model')
await changedMaterials(page, audit)
await stagedModel(page, audit)
await confidentModel(page, audit)
await nextPhotographs(page, audit)

// Downloads: the frame that is seen, and the model itself.
for (const [button, name, least] of [['Save the picture', /\.png$/, 500], ['↓ model.safetensors', /^model\.safetensors$/, 10_000]]) {
  const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: button }).click()])
  assert.match(download.suggestedFilename(), name)
  assert.ok(statSync(await download.path()).size >= least, button)
}

// Made on the server: a turntable, with a download by a signed URL.
await page.getByLabel('What', { exact: true }).selectOption('frames')
await page.getByLabel('Frames').fill('3')
await page.getByLabel('Side, px').fill('64')
await page.getByRole('button', { name: 'Make it' }).click()
const turntable = page.getByRole('button', { name: '↓ Turntable, pictures, 3 frames, 64 × 64 px, studio' })
await turntable.waitFor()
const [zip] = await Promise.all([page.waitForEvent('download'), turntable.click()])
assert.match(zip.suggestedFilename(), /\.zip$/)
assert.equal(readFileSync(await zip.path()).subarray(0, 2).toString(), 'PK')
await page.getByLabel('What', { exact: true }).selectOption('ply')
await page.getByRole('button', { name: 'Make it' }).click()
await page.getByRole('button', { name: '↓ PLY, relightable' }).waitFor()
await audit(page, 'model-exports')
await page.getByRole('button', { name: 'Delete PLY, relightable' }).click()
await page.getByRole('button', { name: '↓ PLY, relightable' }).waitFor({ state: 'detached' })
await smallerExport(page)
await delitPhotographs(page, audit)

// For people without a key.
await sharedModel(page, open, audit)
await sharedWithoutWebGpu(page, open)

// A phone: nothing is wider than the screen.
const wide = await page.evaluate(() => document.querySelector('relume-viewer').camera().distance)
await page.setViewportSize({ width: 390, height: 844 })
await page.getByRole('button', { name: 'Reset the view' }).click()
await audit(page, 'phone-model')
assert.ok((await page.evaluate(() => document.querySelector('relume-viewer').camera().distance)) > wide, 'the subject fits into a narrow window')

// Another site: the example's page, whose origin the server lists.
const [, model] = page.url().match(/models\/([0-9a-f-]{36})/) ?? []
const embed = await open({ viewport: { width: 900, height: 700 } })
const example = (name) => readFileSync(new URL(`../../examples/embed/${name}`, import.meta.url), 'utf8')
const elsewhere = createServer((request, response) => {
  const name = new URL(request.url, site).pathname.slice(1)
  const known = { 'index.html': 'text/html', 'embed.css': 'text/css' }[name]
  response.writeHead(known ? 200 : 204, { 'Content-Type': known ?? 'text/plain' })
  response.end(known && example(name).replaceAll('http://localhost:7878', base).replace('MODEL', model))
})
await new Promise((listening) => elsewhere.listen(Number(new URL(site).port), '127.0.0.1', listening))
await embed.addInitScript((secret) => {
  addEventListener('relume-ready', () => (globalThis.isReady = true))
  addEventListener('DOMContentLoaded', () => (document.querySelector('relume-viewer').apiKey = secret))
}, key)
await embed.goto(`${site}/index.html`)
await embed.waitForFunction(() => globalThis.isReady)
const size = await embed.evaluate(async () => (await document.querySelector('relume-viewer').snapshot()).size)
assert.ok(size > 500, `the frame on another site has ${size} bytes`)
if (shots) await embed.screenshot({ path: `${shots}/embed.png` })
// A page that gives the element no height.
const sides = await embed.evaluate(() => {
  const element = Object.assign(document.createElement('relume-viewer'), { className: 'free' })
  document.body.append(element)
  return [element.clientWidth, element.clientHeight]
})
assert.ok(Math.abs(sides[1] - 0.75 * sides[0]) <= 1, `without a height the element is ${sides.join(' x ')}`)

await go('/jobs')
await heading('Jobs').waitFor()
await audit(page, 'phone-jobs')

const documentation = await open({ viewport: { width: 1280, height: 900 } })
await documentation.goto(`${base}/docs`)
await documentation.locator('.opblock').first().waitFor()
// Swagger UI has a link inside the button of each operation, begins its headings with h3, and puts its filter outside the landmarks.
await audit(documentation, 'docs', ['nested-interactive', 'heading-order', 'region'])
await documentedApi(documentation, base, key)

assert.deepEqual(faults, [], 'nothing was told to the console')
elsewhere.close()
await browser.close()
console.log('from upload to download: no error, no violation')
