// The panel "Lamps and ground" of the model's page: nothing is loaded before it is opened; lamps and the ground change the picture; the address and exports have them.
import assert from 'node:assert/strict'

/** What the steps share: parts of the panel, its requests, and its pictures. */
function panelOf(page) {
  const panel = page.getByRole('region', { name: 'Lamps and ground' })
  const picture = panel.getByAltText('The model with the lamps')
  const requests = []
  /** The pixels of the picture, reduced. */
  const pixels = () => picture.evaluate((image) => {
    const context = new OffscreenCanvas(80, 60).getContext('2d')
    context.drawImage(image, 0, 0, 80, 60)
    return [...context.getImageData(0, 0, 80, 60).data]
  })
  page.on('request', (request) => request.url().endsWith('/render') && requests.push(JSON.parse(request.postData() ?? '{}')))
  return {
    page, panel, picture,
    /** The requests of the panel, without those of the other parts of the page. */
    asked: () => requests.filter(({ width, height }) => width === 640 && height === 480),
    button: (name) => panel.getByRole('button', { name, exact: true }),
    pixels,
    /** The pixels of the next complete picture, after an action. */
    async renewed(act) {
      const before = await picture.getAttribute('src')
      await act()
      await page.waitForFunction((src) => {
        const image = document.querySelector('.stage img')
        return image.src !== src && image.complete && image.naturalWidth > 0 && !document.querySelector('.stage .late')
      }, before)
      return pixels()
    },
  }
}

/** The greatest difference of two pictures. */
const difference = (a, b) => a.reduce((most, value, i) => Math.max(most, Math.abs(value - b[i])), 0)

/** The closed panel loads nothing. */
async function openedPanel({ page, panel, picture, asked, button, pixels }) {
  await page.reload()
  await page.locator('.viewer-panel .mode').waitFor()
  await page.locator('.poster').waitFor({ state: 'detached' })
  await page.getByRole('button', { name: 'Reset the view' }).click()
  await panel.waitFor()
  await page.waitForTimeout(500)
  assert.deepEqual(asked(), [], 'the closed panel loads nothing')
  await button('Show the lamps').click()
  await picture.waitFor()
  await panel.locator('.late').waitFor({ state: 'detached' })
  return pixels()
}

/** A lamp changes the picture, and a lamp that is off does not. Its handle moves it by keys and by the pointer. */
async function movedLamp(of, first) {
  const { page, panel, asked, button, renewed } = of
  const lit = await renewed(() => button('Add a lamp').click())
  assert.ok(difference(lit, first) > 20, 'a lamp changes the picture')
  assert.deepEqual(asked().at(-1).lamps.map(({ shape, kelvin }) => [shape, kelvin]), [['point', 3200]])
  assert.deepEqual(await renewed(() => panel.getByLabel('Lamp 1 shines').uncheck()), first, 'a lamp that is off')
  assert.deepEqual(await renewed(() => panel.getByLabel('Lamp 1 shines').check()), lit)
  const handle = panel.getByRole('button', { name: 'Lamp 1', exact: true })
  const place = () => Promise.all(['x', 'y', 'z'].map((axis) => panel.getByLabel(axis, { exact: true }).first().inputValue()))
  const before = await place()
  await renewed(() => handle.press('ArrowDown'))
  const lower = await place()
  assert.ok(Number(lower[2]) < Number(before[2]), 'the arrow key moves the lamp down')
  await handle.scrollIntoViewIfNeeded()
  const box = await handle.boundingBox()
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2]
  await renewed(async () => {
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x - 60, y + 40, { steps: 3 })
    await page.mouse.up()
  })
  const now = await handle.boundingBox()
  assert.ok(Math.abs(now.x + now.width / 2 - x + 60) < 2 && Math.abs(now.y + now.height / 2 - y - 40) < 2, 'the handle is at the pointer')
  assert.deepEqual(asked().at(-1).lamps[0].position.map(String), await place(), 'the request has the place of the fields')
}

/** A spot faces the point of a click; beside the model the click has the depth of the middle. */
async function aimedSpot({ panel, picture, asked, renewed }) {
  await renewed(() => panel.getByRole('radio', { name: 'spot', exact: true }).check())
  await panel.getByRole('radio', { name: 'its target' }).check()
  await picture.scrollIntoViewIfNeeded()
  const { width, height } = await picture.boundingBox()
  const target = panel.getByRole('button', { name: 'Target of lamp 1' })
  await renewed(() => picture.click({ position: { x: 0.4 * width, y: 0.58 * height } }))
  await panel.getByText('Lamp 1 faces this point.', { exact: true }).waitFor()
  const [frame, box] = [await picture.boundingBox(), await target.boundingBox()]
  assert.ok(Math.abs((box.x + box.width / 2 - frame.x) / width - 0.4) < 0.01, 'the handle of the target is at the click')
  await renewed(() => picture.click({ position: { x: 0.02 * width, y: 0.03 * height } }))
  await panel.getByText(/^There is no surface at this point\. Lamp 1 faces this point/).waitFor()
  const [{ shape, cone_deg, target: faced }] = asked().at(-1).lamps
  assert.deepEqual([shape, cone_deg, faced.length], ['spot', 45, 3])
}

/** The ground has its colour where it has no shadow and no light of the lamp, and is brighter in the light of the lamp. Other lamps need no new shadow. */
async function groundedModel({ panel, picture, asked, renewed }) {
  await renewed(() => panel.getByLabel('On the ground').check())
  await picture.scrollIntoViewIfNeeded()
  const { width, height } = await picture.boundingBox()
  await renewed(() => picture.click({ position: { x: 0.5 * width, y: 0.6 * height } }))
  await renewed(() => panel.getByRole('slider', { name: 'Cone' }).fill('150'))
  const lit = await renewed(() => panel.getByLabel('Intensity as a number').fill('100'))
  const outputs = asked().flatMap(({ outputs }) => outputs)
  assert.ok(['shadow', 'bounce', 'lamp_light'].every((output) => outputs.includes(output)))
  const requested = () => asked().filter(({ outputs }) => outputs[0] === 'shadow').length
  const before = requested()
  const grounded = await renewed(() => panel.getByLabel('Intensity as a number').fill('0'))
  assert.equal(requested(), before, 'another lamp, the same shadow')
  assert.ok(grounded.every((value, i) => i % 4 !== 3 || value === 255), 'the picture is opaque')
  const floor = [0xb8, 0xb2, 0xa8]
  const bare = Array.from({ length: grounded.length / 4 }, (_, i) => 4 * i).filter((i) => floor.every((value, c) => Math.abs(grounded[i + c] - value) <= 2))
  assert.equal(bare[0], 0, `the upper left corner has the colour of the ground: ${grounded.slice(0, 3)}`)
  const brighter = bare.filter((i) => lit[i] > floor[0] + 4).length
  assert.ok(brighter > 20, `the lamp lights the ground: ${brighter} of ${bare.length} pixels`)
  await renewed(() => panel.getByLabel('Height of the ground').fill('-0.9'))
  assert.equal(asked().at(-1).ground_height, -0.9)
}

/** The address restores the lamps; an export has them. */
async function keptLamps({ page, panel, picture }) {
  await page.waitForFunction(() => /lamps=spot/.test(location.hash) && /floor=/.test(location.hash) && /ground=-0\.9/.test(location.hash))
  const z = await panel.getByLabel('z', { exact: true }).first().inputValue()
  await page.reload()
  await picture.waitFor()
  assert.equal(await panel.getByLabel('z', { exact: true }).first().inputValue(), z)
  await page.getByLabel('What', { exact: true }).selectOption('layers')
  await page.getByText('The pictures have the light of 1 lamp.').waitFor()
  await page.getByLabel('Frames').fill('2')
  await page.getByLabel('Side, px').fill('64')
  await page.getByRole('button', { name: 'Make it' }).click()
  await page.getByRole('button', { name: /^↓ Turntable, layers, 2 frames, .*, with lamps$/ }).waitFor()
  await page.getByRole('button', { name: /^Delete Turntable, layers/ }).click()
  await page.getByRole('button', { name: /^↓ Turntable, layers/ }).waitFor({ state: 'detached' })
  await page.getByLabel('What', { exact: true }).selectOption('gltf')
  await page.getByText('This file has no lamps; turntables have them.').waitFor()
}

/** An error is a sentence, and another attempt helps; four lamps at most; nothing stays in the address. */
async function removedLamps({ page, panel, asked, button, renewed }) {
  await panel.locator('.late').waitFor({ state: 'detached' })
  await renewed(() => panel.getByLabel('On the ground').uncheck())
  const busy = { status: 503, contentType: 'application/problem+json', body: JSON.stringify({ type: 'urn:relume:problem:busy', title: 'Busy', status: 503, request_id: '' }) }
  await page.route('**/render', (route) => route.fulfill(busy))
  await button('Remove lamp 1').click()
  await panel.getByRole('alert').getByText('The server is busy.').waitFor()
  await page.unroute('**/render')
  await renewed(() => button('Try again').click())
  assert.equal(asked().at(-1).lamps, undefined)
  for (let i = 0; i < 4; i++) await button('Add a lamp').click()
  assert.ok(await button('Add a lamp').isDisabled())
  for (let i = 0; i < 4; i++) await button('Remove lamp 1').click()
  await page.waitForFunction(() => !/lamps|floor/.test(location.hash))
  await panel.getByLabel('On the ground').check()
  await panel.getByLabel('Height of the ground').fill('')
  await panel.getByLabel('On the ground').uncheck()
  await button('Hide the lamps').click()
  await page.waitForFunction(() => !/ground/.test(location.hash))
}

/** Opens the panel, adds and moves a lamp, puts the model on a ground, and takes it along. `audit` checks the accessibility of the page. */
export async function stagedModel(page, audit) {
  const panel = panelOf(page)
  const first = await openedPanel(panel)
  await movedLamp(panel, first)
  await aimedSpot(panel)
  await groundedModel(panel)
  await audit(page, 'lamps')
  await keptLamps(panel)
  await removedLamps(panel)
}
