// The panel "Materials" of the model's page: nothing is loaded before it is opened; a change gives another picture; a click in the picture selects a material.
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { held } from './viewing.mjs'

/** Side of the masks of the API, pixels. */
const SIDE = 120

/** A point of the surface of two materials, as shares of the panel's picture. The masks are those of the API, by the first view of the model. */
async function pointsOf(page) {
  const found = await page.evaluate(async (side) => {
    const viewer = document.querySelector('relume-viewer')
    const key = sessionStorage.getItem('relume-api-key')
    const get = (path) => fetch(`v1/models/${viewer.getAttribute('model')}/materials${path}`, { headers: key ? { Authorization: `Bearer ${key}` } : {} })
    const { azimuth, elevation } = viewer.camera()
    const { items } = await (await get('')).json()
    const masks = []
    for (const { material } of items) {
      const picture = await createImageBitmap(await (await get(`/${material}/mask?size=${side}&azimuth=${azimuth}&elevation=${elevation}`)).blob())
      const context = new OffscreenCanvas(side, side).getContext('2d')
      context.drawImage(picture, 0, 0)
      const { data } = context.getImageData(0, 0, side, side)
      const value = (x, y) => (data[4 * (y * side + x)] * data[4 * (y * side + x) + 3]) / 255
      let best = { value: 0 }
      for (let y = 2; y < side - 2; y++) for (let x = 2; x < side - 2; x++) {
        const least = Math.min(...[-2, 0, 2].flatMap((dy) => [-2, 0, 2].map((dx) => value(x + dx, y + dy))))
        if (least > best.value) best = { value: least, x, y }
      }
      masks.push({ material, ...best })
    }
    return masks.sort((a, b) => b.value - a.value).slice(0, 2)
  }, SIDE)
  for (const { material, value } of found) assert.ok(value > 190, `material ${material} is alone at a point: ${value}`)
  // The mask is the square in the middle of a picture of 4:3.
  return found.map(({ material, x, y }) => ({ material, at: [(x + 0.5 + SIDE / 6) / (SIDE * 4 / 3), (y + 0.5) / SIDE] }))
}

/** What the steps share: parts of the panel, its requests, and how its picture is compared. */
function panelOf(page) {
  const panel = page.getByRole('region', { name: 'Materials' })
  const picture = panel.getByAltText('The model with the changes')
  const requests = []
  page.on('request', (request) => /\/materials|\/render$/.test(request.url()) && requests.push({ url: request.url(), body: request.postData() ?? '' }))
  const content = () => picture.evaluate((image) => {
    const context = new OffscreenCanvas(image.naturalWidth, image.naturalHeight).getContext('2d')
    context.drawImage(image, 0, 0)
    return context.getImageData(0, 0, image.naturalWidth, image.naturalHeight).data.reduce((sum, byte) => (31 * sum + byte) >>> 0, 7)
  })
  return {
    page, panel, picture, requests, content,
    /** The requests of the panel, without those of the other parts of the page. */
    asked: () => requests.filter(({ url, body }) => url.endsWith('/materials') || body.includes('"width":640,"height":480') || body.includes('roughness')),
    choice: (material) => panel.locator(`input[type=radio][value="${material}"]`),
    button: (name) => panel.getByRole('button', { name, exact: true }),
    /** The content of the next picture, after an action. */
    async renewed(act) {
      const before = await picture.getAttribute('src')
      await act()
      await page.waitForFunction((src) => {
        const image = document.querySelector('.edited img:not(.mask)')
        return image.src !== src && !image.classList.contains('waiting')
      }, before)
      return content()
    },
  }
}

/** The closed panel loads nothing. */
async function openedPanel({ page, panel, picture, asked, button }) {
  await page.reload()
  await page.locator('.viewer-panel .mode').waitFor()
  await page.locator('.poster').waitFor({ state: 'detached' })
  await page.getByRole('button', { name: 'Reset the view' }).click()
  await panel.waitFor()
  await page.waitForTimeout(500)
  assert.deepEqual(asked(), [], 'the closed panel loads nothing')
  await button('Show the materials').click()
  await picture.waitFor()
}

/** A click selects the material there; beside the model it selects nothing. */
async function clickedMaterials({ panel, picture, requests, choice }, one, two) {
  const click = async ([x, y]) => {
    await picture.scrollIntoViewIfNeeded()
    const { width, height } = await picture.boundingBox()
    await picture.click({ position: { x: x * width, y: y * height } })
  }
  for (const { material, at } of [one, two, one]) {
    await click(at)
    await panel.getByText(`Material ${material} was selected.`).waitFor()
    assert.ok(await choice(material).isChecked(), `a click on material ${material}`)
  }
  await panel.locator('.edited .mask').waitFor()
  await click([0.01, 0.01])
  await panel.getByText('There is no surface at this point.').waitFor()
  assert.ok(await choice(one.material).isChecked())
  const masks = requests.filter(({ body }) => /"outputs":\["(roughness|metallic)"\]/.test(body)).length
  assert.equal(masks, await panel.getByRole('radio').count(), 'each mask is requested once')
}

/** Without a change the same light gives the same picture (the control); a change gives another one. `first` is the picture without changes. */
async function changedPictures({ page, panel, requests, asked, choice, button, renewed }, first, one, two) {
  const light = await page.evaluate(() => new URLSearchParams(location.hash.split('?')[1]).get('light') ?? 'studio')
  const other = light === 'dawn' ? 'night' : 'dawn'
  assert.notEqual(await renewed(() => page.getByRole('radio', { name: other, exact: true }).check()), first, 'another light')
  assert.equal(await renewed(() => page.locator(`.lights input[value="${light}"]`).check()), first, 'without a change')
  assert.ok(await button('Save changes').isDisabled())
  const old = panel.locator('.edited .waiting')
  const release = await held(page, '**/render')
  requests.length = 0
  const blue = await renewed(async () => {
    await panel.getByLabel('Colour').fill('#2244cc')
    await old.waitFor()
    await page.waitForTimeout(600)
    await panel.getByRole('slider', { name: 'Roughness' }).fill('0.1')
    await page.waitForTimeout(600)
    assert.equal(asked().length, 1, 'one request at a time')
    await release()
    await old.waitFor({ state: 'detached' })
  })
  assert.notEqual(blue, first, 'another colour')
  const colour = { material: one.material, colour: '#2244cc' }
  assert.deepEqual(asked().map(({ body }) => JSON.parse(body).materials), [[colour], [{ ...colour, roughness: 0.1 }]])
  await panel.getByText('1 material is changed.').waitFor()
  await choice(two.material).check()
  await renewed(() => panel.getByRole('slider', { name: 'Metalness' }).press('ArrowRight'))
}

/** The changes in a file and in an export. */
async function savedChanges({ page, button }, one, two) {
  const [download] = await Promise.all([page.waitForEvent('download'), button('Save changes').click()])
  assert.match(download.suggestedFilename(), /-materials\.json$/)
  const saved = JSON.parse(readFileSync(await download.path(), 'utf8'))
  assert.deepEqual(saved.map(({ material }) => material), [one.material, two.material].sort((a, b) => a - b))
  assert.deepEqual(saved.find(({ material }) => material === one.material), { material: one.material, colour: '#2244cc', roughness: 0.1 })
  await page.getByLabel('What', { exact: true }).selectOption('gltf')
  await page.getByText('The file has the changes of 2 materials, under the chosen light.').waitFor()
  await page.getByRole('button', { name: 'Make it' }).click()
  await page.getByRole('button', { name: /^↓ GLTF, .*, materials changed$/ }).waitFor()
  await page.getByRole('button', { name: /^Delete GLTF, .*, materials changed$/ }).click()
  await page.getByRole('button', { name: /^↓ GLTF, .*, materials changed$/ }).waitFor({ state: 'detached' })
}

/** A merged material leaves the list, the picture stays about the same, and a click on it selects the other one. Undoing brings it back. */
async function mergedMaterials({ panel, picture, choice, button, renewed }, one, two) {
  await choice(two.material).check()
  const before = await panel.getByRole('radio').count()
  await renewed(() => panel.getByLabel(`Merge material ${two.material} into`).selectOption(String(one.material)))
  await panel.getByText(`Material ${two.material} is now part of material ${one.material}.`).waitFor()
  assert.equal(await panel.getByRole('radio').count(), before - 1)
  assert.ok(await choice(one.material).isChecked())
  await picture.scrollIntoViewIfNeeded()
  const { width, height } = await picture.boundingBox()
  await picture.click({ position: { x: two.at[0] * width, y: two.at[1] * height } })
  await panel.getByText(`Material ${one.material} was selected.`).waitFor()
  await renewed(() => button('Undo').click())
  assert.equal(await panel.getByRole('radio').count(), before)
}

/** Undoing of one and of all; an error is a sentence, and another attempt helps. */
async function undoneChanges({ page, panel, picture, button, renewed }, first) {
  await renewed(() => button('Undo').click())
  await panel.getByText('1 material is changed.').waitFor()
  const busy = { status: 503, contentType: 'application/problem+json', body: JSON.stringify({ type: 'urn:relume:problem:busy', title: 'Busy', status: 503, request_id: '' }) }
  await page.route('**/render', (route) => route.fulfill(busy))
  await button('Undo all').click()
  await panel.getByRole('alert').getByText('The server is busy.').waitFor()
  await page.unroute('**/render')
  assert.equal(await renewed(() => button('Try again').click()), first, 'all changes are undone')
  await button('Hide the materials').click()
  await picture.waitFor({ state: 'detached' })
  await button('Show the materials').click()
  await picture.waitFor()
}

/** Opens the panel, selects and changes materials, compares the pictures, and takes the changes along. `audit` checks the accessibility of the page. */
export async function changedMaterials(page, audit) {
  const panel = panelOf(page)
  await openedPanel(panel)
  const [one, two] = await pointsOf(page)
  await clickedMaterials(panel, one, two)
  const first = await panel.content()
  await mergedMaterials(panel, one, two)
  await changedPictures(panel, first, one, two)
  await audit(page, 'materials')
  await savedChanges(panel, one, two)
  await undoneChanges(panel, first)
}
