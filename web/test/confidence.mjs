// The panel "Confidence" of the model's page: nothing is loaded before it is opened; the colours are those of the server's confidence; a model without confidence is told in one sentence.
import assert from 'node:assert/strict'

/** The pixels of a picture of the page: of its box reduced to 80 x 60. */
const pixels = (picture) => picture.evaluate((image) => {
  const context = new OffscreenCanvas(80, 60).getContext('2d')
  context.drawImage(image, 0, 0, 80, 60)
  return [...context.getImageData(0, 0, 80, 60).data]
})

/** The colours are on the model alone, and are those of the scale. */
function areColoured(data) {
  const counts = { clear: 0, covered: 0 }
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] === 0) counts.clear++
    if (data[i + 3] < 180) continue
    counts.covered++
    const [red, , blue] = data.slice(i, i + 3)
    // Orange to pale has much red, pale to blue has much blue.
    assert.ok(red >= 205 || blue >= 170, `a colour of the scale: ${data.slice(i, i + 3)}`)
  }
  assert.ok(counts.clear > 500 && counts.covered > 200, `the colours are on the model: ${JSON.stringify(counts)}`)
}

/** Opens the panel, switches the colours, changes view and light, and shows a model without confidence. `audit` checks the accessibility of the page. */
export async function confidentModel(page, audit) {
  const panel = page.getByRole('region', { name: 'Confidence' })
  const colours = panel.getByAltText(/^Its confidence/)
  const picture = panel.getByAltText('The model in the current view')
  const requests = []
  const listen = (request) => request.url().endsWith('/render') && requests.push(JSON.parse(request.postData() ?? '{}'))
  page.on('request', listen)
  const asked = () => requests.filter(({ outputs }) => outputs?.[0] === 'confidence')
  await panel.getByRole('button', { name: 'Where to photograph next' }).waitFor()
  await page.waitForTimeout(500)
  assert.deepEqual(requests, [], 'the closed panel loads nothing')
  await panel.getByRole('button', { name: 'Show the confidence' }).click()
  await colours.waitFor()
  assert.deepEqual(asked().map((request) => Object.keys(request).sort().join()), ['camera,height,outputs,width'])
  areColoured(await pixels(colours))
  await panel.getByText('low: guess').waitFor()
  await panel.getByText('high: well determined').waitFor()
  await audit(page, 'confidence')

  await panel.getByLabel('Confidence over the picture').uncheck()
  assert.equal(await colours.count(), 0)
  await picture.waitFor()
  await panel.getByLabel('Confidence over the picture').check()
  await colours.waitFor()

  // Another light has another picture and the same confidence; another view has another confidence.
  const light = await page.getByRole('radio', { name: 'overcast' }).isChecked() ? 'dawn' : 'overcast'
  const before = await picture.getAttribute('src')
  await page.getByRole('radio', { name: light }).check()
  await page.waitForFunction((src) => document.querySelector('.confidence .edited img').src !== src, before)
  assert.equal(asked().length, 1, 'another light, the same confidence')
  const renewed = page.waitForRequest((request) => request.url().endsWith('/render') && Boolean(request.postData()?.includes('confidence')))
  await page.locator('relume-viewer').press('ArrowRight')
  assert.notDeepEqual(JSON.parse((await renewed).postData()).camera, asked()[0].camera)
  await panel.locator('.late').waitFor({ state: 'detached' })
  areColoured(await pixels(colours))
  await page.getByRole('radio', { name: 'studio' }).check()

  // A busy server: another attempt helps. A model without confidence: a sentence and no other attempt.
  const answer = (status, problem) => (route) => (route.request().postData()?.includes('confidence') ? route.fulfill({ status, contentType: 'application/problem+json', body: JSON.stringify({ title: '', status, request_id: '', ...problem }) }) : route.continue())
  await page.route('**/render', answer(503, { type: 'urn:relume:problem:busy' }))
  await page.locator('relume-viewer').press('ArrowLeft')
  await panel.getByRole('alert').getByText('The server is busy.').waitFor()
  await page.unroute('**/render')
  await panel.getByRole('button', { name: 'Try again' }).click()
  await colours.waitFor()
  const detail = 'the model has no confidence; train it again with this version'
  await page.route('**/render', answer(422, { type: 'urn:relume:problem:invalid-field', detail, errors: [{ pointer: '/outputs', detail }] }))
  await panel.getByRole('button', { name: 'Hide the confidence' }).click()
  await panel.getByRole('button', { name: 'Show the confidence' }).click()
  await panel.getByText(/^This model has no confidence\./).waitFor()
  assert.equal(await panel.getByRole('button', { name: 'Try again' }).count(), 0)
  assert.equal(await panel.getByRole('img').count(), 0)
  await page.unroute('**/render')
  await panel.getByRole('button', { name: 'Hide the confidence' }).click()
  page.off('request', listen)
}

/** An export of fewer Gaussians; a turntable has no such field. */
export async function smallerExport(page) {
  const most = page.getByLabel('Gaussians at most (optional)')
  await page.getByLabel('What', { exact: true }).selectOption('frames')
  assert.equal(await most.count(), 0)
  await page.getByLabel('What', { exact: true }).selectOption('ply')
  await most.fill('100')
  const sent = page.waitForRequest((request) => request.method() === 'POST' && request.url().endsWith('/exports'))
  await page.getByRole('button', { name: 'Make it' }).click()
  assert.deepEqual(JSON.parse((await sent).postData()), { kind: 'ply', max_splats: 100 })
  await page.getByRole('button', { name: '↓ PLY, relightable, at most 100 Gaussians' }).waitFor()
  await page.getByRole('button', { name: 'Delete PLY, relightable, at most 100 Gaussians' }).click()
  await page.getByRole('button', { name: '↓ PLY, relightable, at most 100 Gaussians' }).waitFor({ state: 'detached' })
  await most.fill('')
}
