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

/** Opens the panel, changes materials, compares the pictures, and takes the changes along. `audit` checks the accessibility of the page. */
export async function changedMaterials(page, audit) {
  const panel = page.getByRole('region', { name: 'Materials' })
  const picture = panel.getByAltText('The model with the changes')
  const old = panel.locator('.edited .waiting')
  const requests = []
  const remember = (request) => /\/materials|\/render$/.test(request.url()) && requests.push({ url: request.url(), body: request.postData() ?? '' })
  const isOfPanel = ({ url, body }) => url.endsWith('/materials') || body.includes('"width":640,"height":480') || body.includes('roughness')
  page.on('request', remember)
  await page.reload()
  await page.locator('.viewer-panel .mode').waitFor()
  await page.locator('.poster').waitFor({ state: 'detached' })
  await page.getByRole('button', { name: 'Reset the view' }).click()
  await panel.waitFor()
  await page.waitForTimeout(500)
  assert.deepEqual(requests.filter(isOfPanel), [], 'the closed panel loads nothing')
  await panel.getByRole('button', { name: 'Show the materials' }).click()
  await picture.waitFor()
  const content = () => picture.evaluate((image) => {
    const context = new OffscreenCanvas(image.naturalWidth, image.naturalHeight).getContext('2d')
    context.drawImage(image, 0, 0)
    return context.getImageData(0, 0, image.naturalWidth, image.naturalHeight).data.reduce((sum, byte) => (31 * sum + byte) >>> 0, 7)
  })
  const renewed = async (act) => {
    const before = await picture.getAttribute('src')
    await act()
    await page.waitForFunction((src) => {
      const image = document.querySelector('.edited img:not(.mask)')
      return image.src !== src && !image.classList.contains('waiting')
    }, before)
    return content()
  }
  const [one, two] = await pointsOf(page)
  const choice = (material) => panel.locator(`input[type=radio][value="${material}"]`)
  const click = async ([x, y]) => {
    await picture.scrollIntoViewIfNeeded()
    const { width, height } = await picture.boundingBox()
    await picture.click({ position: { x: x * width, y: y * height } })
  }

  // A click selects the material there; beside the model it selects nothing.
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

  // The control: without a change the same light gives the same picture; a change gives another one, its undoing the first one.
  const first = await content()
  const light = await page.evaluate(() => new URLSearchParams(location.hash.split('?')[1]).get('light') ?? 'studio')
  const other = light === 'dawn' ? 'night' : 'dawn'
  assert.notEqual(await renewed(() => page.getByRole('radio', { name: other, exact: true }).check()), first, 'another light')
  assert.equal(await renewed(() => page.locator(`.lights input[value="${light}"]`).check()), first, 'without a change')
  assert.ok(await panel.getByRole('button', { name: 'Save changes' }).isDisabled())
  const colour = panel.getByLabel('Colour')
  const own = await colour.inputValue()
  const release = await held(page, '**/render')
  requests.length = 0
  const blue = await renewed(async () => {
    await colour.fill('#2244cc')
    await old.waitFor()
    await page.waitForTimeout(600)
    await panel.getByRole('slider', { name: 'Roughness' }).fill('0.1')
    await page.waitForTimeout(600)
    assert.equal(requests.filter(isOfPanel).length, 1, 'one request at a time')
    await release()
    await old.waitFor({ state: 'detached' })
  })
  assert.notEqual(blue, first, 'another colour')
  assert.deepEqual(requests.filter(isOfPanel).map(({ body }) => JSON.parse(body).materials), [
    [{ material: one.material, colour: '#2244cc' }], [{ material: one.material, colour: '#2244cc', roughness: 0.1 }],
  ])
  await panel.getByText('1 material is changed.').waitFor()
  await choice(two.material).check()
  await renewed(() => panel.getByRole('slider', { name: 'Metalness' }).press('ArrowRight'))
  await audit(page, 'materials')

  // The changes in a file and in an export.
  const [download] = await Promise.all([page.waitForEvent('download'), panel.getByRole('button', { name: 'Save changes' }).click()])
  assert.match(download.suggestedFilename(), /-materials\.json$/)
  const saved = JSON.parse(readFileSync(await download.path(), 'utf8'))
  assert.deepEqual(saved.map(({ material }) => material), [one.material, two.material].sort((a, b) => a - b))
  assert.deepEqual(saved.find(({ material }) => material === one.material), { material: one.material, colour: '#2244cc', roughness: 0.1 })
  await page.getByLabel('What', { exact: true }).selectOption('gltf')
  await page.getByText('The file has the changes of 2 materials, under the chosen light.').waitFor()
  await page.getByRole('button', { name: 'Make it' }).click()
  await page.getByRole('button', { name: /^↓ GLTF, .*, materials changed$/ }).waitFor()
  await page.getByRole('button', { name: /^Delete GLTF, .*, materials changed$/ }).click()
  await page.getByRole('button', { name: /^↓ GLTF/ }).waitFor({ state: 'detached' })

  // Undoing of one and of all; an error is a sentence, and another attempt helps.
  await renewed(() => panel.getByRole('button', { name: 'Undo', exact: true }).click())
  await panel.getByText('1 material is changed.').waitFor()
  const busy = { status: 503, contentType: 'application/problem+json', body: JSON.stringify({ type: 'urn:relume:problem:busy', title: 'Busy', status: 503, request_id: '' }) }
  await page.route('**/render', (route) => route.fulfill(busy))
  await panel.getByRole('button', { name: 'Undo all' }).click()
  await panel.getByRole('alert').getByText('The server is busy.').waitFor()
  await page.unroute('**/render')
  assert.equal(await renewed(() => panel.getByRole('button', { name: 'Try again' }).click()), first, 'all changes are undone')
  await choice(one.material).check()
  assert.equal(await colour.inputValue(), own)
  await panel.getByRole('button', { name: 'Hide the materials' }).click()
  await picture.waitFor({ state: 'detached' })
  await panel.getByRole('button', { name: 'Show the materials' }).click()
  await picture.waitFor()
  page.off('request', remember)
}
