// The viewer of the model's page: what it shows while it loads, its camera, its light, and what it gives away.
import assert from 'node:assert/strict'

const camera = (page) => page.evaluate(() => document.querySelector('relume-viewer').camera())
const hash = (page, pattern) => page.waitForFunction((text) => new RegExp(text).test(location.hash), pattern)

/** Holds back the answers to requests; returns the function that lets them through. */
export async function held(page, pattern) {
  let release
  const released = new Promise((resolve) => (release = resolve))
  await page.route(pattern, async (route) => {
    await released
    await route.continue().catch(() => {})
  })
  return async () => {
    release()
    await page.unroute(pattern)
  }
}

/** Opens a model by its link: its picture and how much has arrived, then the viewer. */
export async function openedModel(page, link) {
  const [model, light] = [await held(page, '**/stream'), await held(page, '**/light?*')]
  await link.click()
  await page.locator('.poster img').waitFor()
  await page.locator('.poster').getByText('The model is being loaded').waitFor()
  await model()
  const isDrawnHere = await page.waitForFunction(() => /light is on its way|draws the model/.test(document.querySelector('.viewer-panel').textContent))
  assert.ok(isDrawnHere)
  await light()
  await page.locator('.viewer-panel .mode').waitFor()
  await page.locator('.poster').waitFor({ state: 'detached' })
}

/** Calibrates the model by a patch, compares the pictures, and undoes it. */
export async function calibratedModel(page) {
  const albedo = () => page.evaluate(async () => {
    const model = document.querySelector('relume-viewer').getAttribute('model')
    const key = sessionStorage.getItem('relume-api-key')
    const answer = await fetch(`v1/models/${model}`, { headers: key ? { Authorization: `Bearer ${key}` } : {} })
    const { calibration, files } = await answer.json()
    return { calibration, sha256: files.map((file) => file.sha256).join() }
  })
  const before = await albedo()
  assert.equal(before.calibration, undefined)
  await page.getByRole('button', { name: 'Choose a surface' }).click()
  await page.getByRole('button', { name: 'Apply' }).click()
  await page.getByRole('alert').getByText('No surface is chosen.').waitFor()
  const panel = page.getByRole('region', { name: 'Calibrate colour' })
  const picture = panel.locator('.patch img')
  await picture.waitFor()
  await picture.scrollIntoViewIfNeeded()
  const box = await picture.boundingBox()
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2]
  await page.mouse.move(x - 10, y - 10)
  await page.mouse.down()
  await page.mouse.move(x + 20, y + 10)
  await page.mouse.up()
  await panel.locator('.patch span').waitFor()
  await panel.getByLabel('Surface', { exact: true }).selectOption('own')
  const reflectance = panel.getByLabel('Reflectance, or red, green, blue')
  await reflectance.fill('0.5, 2')
  await page.getByRole('button', { name: 'Apply' }).click()
  await page.getByRole('alert').getByText('The reflectance is one number or three').waitFor()
  await reflectance.fill('0.5, 0.3, 0.2')
  await page.getByRole('button', { name: 'Apply' }).click()
  await panel.getByText('Calibrated to the reflectance 0.50, 0.30, 0.20.').waitFor()
  const after = await albedo()
  assert.notEqual(after.sha256, before.sha256)
  assert.ok(after.calibration.patch.width > after.calibration.patch.height, 'the dragged rectangle')
  await page.locator('.viewer-panel .mode').waitFor()
  await page.getByRole('button', { name: 'Undo' }).click()
  await panel.getByText('The calibration was undone.').waitFor()
  await page.getByRole('button', { name: 'Undo' }).waitFor({ state: 'detached' })
  assert.equal((await albedo()).calibration, undefined)
  await page.locator('.viewer-panel .mode').waitFor()
  await page.locator('.poster').waitFor({ state: 'detached' })
}

/** A chosen light dims the picture until it has arrived. */
export async function dimmedLight(page) {
  const release = await held(page, /\/(light\?|render$)/)
  await page.getByRole('radio', { name: 'sunset' }).check()
  await page.getByText('The light is on its way').waitFor()
  const isDim = () => page.evaluate(() => document.querySelector('relume-viewer').shadowRoot.querySelector('canvas, img').classList.contains('waiting'))
  assert.ok(await isDim(), 'the picture of the previous light is dim')
  await release()
  await page.getByText('The light is on its way').waitFor({ state: 'detached' })
  assert.ok(!(await isDim()))
  await hash(page, 'light=sunset')
}

/** Reset, pan and focus. */
export async function movedCamera(page) {
  const viewer = page.locator('relume-viewer')
  const first = await camera(page)
  await viewer.press('ArrowRight')
  assert.notEqual((await camera(page)).azimuth, first.azimuth)
  await viewer.press('Shift+ArrowUp')
  assert.notDeepEqual((await camera(page)).target, first.target)
  await hash(page, 'target=')
  await page.getByRole('button', { name: 'Reset the view' }).click()
  assert.deepEqual(await camera(page), first)
  const box = await viewer.boundingBox()
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2]
  await page.mouse.dblclick(x + 60, y - 20)
  const focused = await camera(page)
  assert.ok(focused.distance < first.distance, 'a double click comes closer')
  assert.notDeepEqual(focused.target, first.target)
  await viewer.press('Home')
  await page.keyboard.down('Shift')
  await page.mouse.move(x, y)
  await page.mouse.down()
  await page.mouse.move(x + 40, y)
  await page.mouse.up()
  await page.keyboard.up('Shift')
  const panned = await camera(page)
  assert.equal(panned.azimuth, first.azimuth, 'Shift and a drag do not turn')
  assert.notDeepEqual(panned.target, first.target)
  await viewer.press('Home')
  assert.equal(await viewer.evaluate((element) => getComputedStyle(element).touchAction), 'pan-y', 'a finger scrolls the page')
  await page.waitForFunction(() => !location.hash.includes('target'))
}

/** The dial turns the light by keyboard and by drag. */
export async function turnedLight(page) {
  const dial = page.getByRole('slider', { name: 'Direction of the light' })
  await dial.press('ArrowRight')
  await hash(page, 'rotation=5(&|$)')
  const box = await dial.boundingBox()
  await page.mouse.move(box.x + box.width / 2, box.y + box.height - 6)
  await page.mouse.down()
  await page.mouse.move(box.x + box.width - 6, box.y + box.height / 2)
  await page.mouse.up()
  await hash(page, 'rotation=90(&|$)')
  assert.equal(await dial.getAttribute('aria-valuenow'), '90')
  await page.getByLabel('Turn the light', { exact: true }).fill('0')
}

/** Full screen, rounded links, HTML for another page, lights side by side. */
export async function takenAway(page, base) {
  await page.getByRole('button', { name: 'Full screen' }).click()
  await page.waitForFunction(() => document.fullscreenElement !== null)
  await page.evaluate(() => document.exitFullscreen())
  await page.locator('relume-viewer').press('ArrowLeft')
  await page.waitForTimeout(400)
  assert.match(page.url(), /azimuth=-?\d+(\.\d)?&elevation=-?\d+(\.\d)?&/)
  await page.getByText('Embed', { exact: true }).click()
  await page.getByRole('button', { name: 'Copy the HTML' }).click()
  await page.getByText('The HTML was copied').waitFor()
  const html = await page.evaluate(() => navigator.clipboard.readText())
  assert.ok(html.includes(`src="${base}/relume-viewer.js"`) && /<relume-viewer model="[0-9a-f-]{36}" environment=/.test(html), html)
  await page.getByRole('button', { name: 'Show the model in every light' }).click()
  await page.getByRole('button', { name: 'Choose the light dawn' }).getByRole('img', { includeHidden: true }).or(page.locator('.side img')).first().waitFor()
  await page.getByRole('button', { name: 'Choose the light dawn' }).click()
  await hash(page, 'light=dawn')
}
