// The places for further photographs in the panel "Confidence" of the model's page: their list, their marks in the picture, the view from them, and their file.
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'

const camera = (page) => page.evaluate(() => document.querySelector('relume-viewer').camera())

/** Answers requests for the places with an error until the route is removed. */
const refuse = (page, status, type) =>
  page.route('**/next-photographs', (route) => route.fulfill({ status, contentType: 'application/problem+json', body: JSON.stringify({ type: `urn:relume:problem:${type}`, title: '', status, request_id: '' }) }))

/** Whether the viewer has the direction of a place. */
async function isSeenFrom(page, { azimuth_deg, elevation_deg }) {
  const { azimuth, elevation } = await camera(page)
  assert.ok(Math.abs(azimuth - azimuth_deg) < 0.01 && Math.abs(elevation - elevation_deg) < 0.01, `the view is at ${azimuth}, ${elevation}, not at ${azimuth_deg}, ${elevation_deg}`)
}

/** The list after a first attempt that the server refuses. */
async function listedPlaces(page, panel) {
  const asked = []
  page.on('request', (request) => request.url().endsWith('/next-photographs') && asked.push(request.postData()))
  await page.getByRole('button', { name: 'Reset the view' }).click()
  await refuse(page, 503, 'busy')
  await panel.getByRole('button', { name: 'Where to photograph next' }).click()
  await panel.getByRole('alert').getByText('The server is busy.').waitFor()
  await page.unroute('**/next-photographs')
  const answered = page.waitForResponse((answer) => answer.url().endsWith('/next-photographs'))
  await panel.getByRole('button', { name: 'Try again' }).click()
  const answer = await (await answered).json()
  const rows = panel.getByRole('list', { name: 'Where to photograph next' }).getByRole('button')
  await rows.nth(9).waitFor()
  assert.deepEqual([answer.cameras.length, await rows.count()], [10, 10])
  assert.deepEqual(asked, ['{"count":10}', '{"count":10}'])
  const { azimuth_deg } = answer.cameras[0]
  const turn = Math.round(azimuth_deg) > 180 ? `${360 - Math.round(azimuth_deg)}° to the left` : `${Math.round(azimuth_deg)}° to the right`
  assert.match(await rows.first().textContent(), new RegExp(`^1 · (${turn} of|opposite|on the side of) the first photograph, (level|\\d+° (up|down))$`))
  await rows.first().scrollIntoViewIfNeeded()
  await rows.first().locator('img').waitFor()
  return { answer, rows }
}

/** Marks in the picture, and the view from a place by the list and by a mark. */
async function visitedPlaces(page, panel, { answer, rows }) {
  const marks = panel.getByRole('button', { name: /^Camera \d+: / })
  const first = await camera(page)
  await rows.nth(1).click()
  await isSeenFrom(page, answer.cameras[1])
  assert.equal((await camera(page)).distance, first.distance)
  await panel.locator('.late').waitFor({ state: 'detached' })
  assert.deepEqual(await rows.evaluateAll((all) => all.map((row) => row.ariaCurrent)), answer.cameras.map((_, i) => String(i === 1)))
  // From far away all cameras are in the picture, the one of this place in its middle.
  await panel.getByRole('button', { name: 'Show all cameras' }).click()
  await isSeenFrom(page, answer.cameras[1])
  await marks.nth(9).waitFor()
  await panel.locator('.late').waitFor({ state: 'detached' })
  const frame = await panel.locator('.edited').boundingBox()
  const box = await panel.getByRole('button', { name: /^Camera 2: / }).boundingBox()
  const [x, y] = [(box.x + box.width / 2 - frame.x) / frame.width, (box.y + box.height / 2 - frame.y) / frame.height]
  assert.ok(Math.abs(x - 0.5) < 0.02 && Math.abs(y - 0.5) < 0.02, `the camera of the view is at ${x}, ${y}`)
  assert.equal(await panel.locator('.camera-mark.behind').filter({ hasText: /^2$/ }).count(), 0)
  await panel.getByRole('button', { name: /^Camera 3: / }).press('Enter')
  await isSeenFrom(page, answer.cameras[2])
  assert.equal((await camera(page)).distance, first.distance, 'a place shows the whole model')
}

/** Lists the places, visits some, saves their file, and shows a model without a subject. `audit` checks the accessibility of the page. */
export async function nextPhotographs(page, audit) {
  const panel = page.getByRole('region', { name: 'Confidence' })
  const places = await listedPlaces(page, panel)
  await panel.getByAltText(/^Its confidence/).waitFor()
  await audit(page, 'next-photographs')
  await visitedPlaces(page, panel, places)
  const [file] = await Promise.all([page.waitForEvent('download'), panel.getByRole('button', { name: '↓ next-photographs.json' }).click()])
  assert.equal(file.suggestedFilename(), 'next-photographs.json')
  // As text, which has no -0.
  assert.equal(JSON.stringify(JSON.parse(readFileSync(await file.path(), 'utf8'))), JSON.stringify(places.answer))
  await panel.getByRole('button', { name: 'Hide the places' }).click()
  assert.equal(await panel.locator('.camera-mark').count(), 0)
  await panel.getByAltText(/^Its confidence/).waitFor()

  await refuse(page, 409, 'no-subject')
  await page.reload()
  await panel.getByRole('button', { name: 'Where to photograph next' }).click()
  await panel.getByRole('alert').getByText('The photographs of this model do not surround a subject.').waitFor()
  assert.equal(await panel.getByRole('button', { name: 'Try again' }).count(), 0)
  await page.unroute('**/next-photographs')
  await panel.getByRole('button', { name: 'Hide the confidence' }).click()
  await page.locator('.poster').waitFor({ state: 'detached' })
  await page.getByRole('button', { name: 'Reset the view' }).click()
}
