// What the app says when something goes wrong, in its own words, and how the user goes on.
import assert from 'node:assert/strict'
import { basename } from 'node:path'

const alert = (page, text) => page.getByRole('alert').filter({ hasText: text }).first()

/** While the dialog asks for a key, the page sends no requests that need one. `open` opens a new page. */
export async function keyIsNotPolled(open, base) {
  const page = await open({})
  await page.clock.install()
  const refused = []
  page.on('response', (answer) => answer.status() === 401 && refused.push(answer.url()))
  await page.goto(base)
  await page.getByRole('dialog').waitFor()
  await page.waitForTimeout(300)
  const before = refused.length
  for (let i = 0; i < 4; i++) {
    await page.clock.fastForward(6000)
    await page.waitForTimeout(100)
  }
  assert.equal(refused.length, before, 'the dialog is open, and nothing polls behind it')
  await page.context().close()
}

/** Files that are no capture, and files that the server refuses. `photos` is a folder of photographs. */
export async function wrongFiles(page, photos) {
  const input = page.getByLabel('Files of a capture')
  const refuse = (kind, status) => (route) => {
    const problem = { type: `urn:relume:problem:${kind}`, title: kind, status, detail: kind, request_id: 'r' }
    return route.request().method() === 'POST' ? route.fulfill({ status, contentType: 'application/problem+json', body: JSON.stringify(problem) }) : route.continue()
  }
  await page.route('**/v1/uploads', refuse('too-large', 413))
  await input.setInputFiles({ name: 'large.zip', mimeType: 'application/zip', buffer: Buffer.from('PK') })
  await alert(page, 'This is larger than the server accepts.').waitFor()
  await page.unroute('**/v1/uploads')
  await page.route('**/v1/captures?*', refuse('insufficient-storage', 507))
  const sent = page.waitForRequest((request) => request.method() === 'POST' && request.url().includes('/v1/captures?'))
  await page.getByLabel('Folder of a capture').setInputFiles(photos)
  await alert(page, 'The disk of the server is full.').getByRole('button', { name: 'Try again' }).waitFor()
  assert.equal(new URL((await sent).url()).searchParams.get('name'), basename(photos), 'a capture has the name of its folder')
  await page.unroute('**/v1/captures?*')
  await input.setInputFiles({ name: 'letter.pdf', mimeType: 'application/pdf', buffer: Buffer.from('%PDF') })
  await alert(page, 'letter.pdf is no photograph and no zip').waitFor()
  await input.setInputFiles({ name: 'clip.mov', mimeType: 'video/quicktime', buffer: Buffer.from('moov') })
  await alert(page, 'clip.mov is a video').waitFor()
  await input.setInputFiles({ name: 'broken.zip', mimeType: 'application/zip', buffer: Buffer.from('PK no zip at all') })
  await alert(page, 'The file is damaged, or it is not a zip or tar.').waitFor()
  await page.getByRole('link', { name: 'Send other files' }).click()
  await input.waitFor({ state: 'attached' })
}

/** A server that does not answer, and then does. */
export async function lostServer(page, go) {
  await page.route('**/v1/models?*', (route) => route.abort('connectionrefused'))
  await go('/models')
  await alert(page, 'The server does not answer.').waitFor()
  await page.unroute('**/v1/models?*')
  await alert(page, 'The server does not answer.').getByRole('button', { name: 'Try again' }).click()
  await page.getByRole('listitem').first().waitFor()
  await alert(page, 'The server does not answer.').waitFor({ state: 'detached' })
}

/** Paths that do not exist, in the address bar and in the app. */
export async function unknownPaths(page, base, audit) {
  await page.goto(`${base}/models/none`)
  await page.getByRole('heading', { level: 1, name: 'No such model' }).waitFor()
  await audit(page, 'no-such-model')
  await page.getByRole('link', { name: 'Show all models' }).waitFor()
  for (const [path, heading] of [['jobs/none', 'No such training'], ['captures/none', 'No such capture'], ['nothing/here', 'There is no such page'], ['models/%E0', 'No such model']]) {
    await page.evaluate((to) => (location.hash = to), `/${path}`)
    await page.getByRole('heading', { level: 1, name: heading }).waitFor()
  }
}

/** Chooses white paper in a photograph by a click. */
async function greyCard(page) {
  await page.getByLabel('Light of the photographs').selectOption('card')
  await page.getByRole('button', { name: 'Start training' }).click()
  await alert(page, 'No grey or white surface is chosen.').waitFor()
  await page.getByLabel('Surface', { exact: true }).selectOption('0.85')
  const picture = page.locator('.patch img')
  await picture.waitFor()
  const box = await picture.boundingBox()
  await picture.click({ position: { x: box.width / 4, y: box.height / 2 } })
  await page.locator('.patch span').waitFor()
  await page.getByRole('button', { name: 'Start training' }).click()
  await alert(page, 'The server is busy.').waitFor()
}

/** A refused training: the settings that were sent, and the refusal on the page. */
export async function refusedTraining(page) {
  let sent
  await page.route('**/v1/jobs', (route) => {
    if (route.request().method() !== 'POST') return route.continue()
    sent = route.request().postDataJSON()
    const problem = { type: 'urn:relume:problem:busy', title: 'Busy', status: 503, detail: 'too many requests', request_id: 'r' }
    return route.fulfill({ status: 503, contentType: 'application/problem+json', body: JSON.stringify(problem) })
  })
  await page.getByRole('radio', { name: '10 minutes' }).check()
  await page.getByText('It takes 10 minutes.').waitFor()
  await page.getByLabel('Light of the photographs').selectOption('daylight')
  assert.ok(await page.getByLabel('What becomes the model').isDisabled(), 'the sample has masks')
  await page.getByText('Details', { exact: true }).first().click()
  await page.getByLabel('Photographs under several lights').fill('noon = train_00*, evening=train_01*')
  await page.getByRole('button', { name: 'Start training' }).click()
  await alert(page, 'The server is busy.').waitFor()
  const light_groups = { noon: 'train_00*', evening: 'train_01*' }
  assert.deepEqual(sent.overrides, { time_budget_s: 600, white_balance: 'daylight', light_groups })
  await page.getByLabel('Photographs under several lights').fill('')
  await page.getByText('Details', { exact: true }).first().click()
  assert.equal(sent.preset, undefined)
  await greyCard(page)
  assert.deepEqual(Object.keys(sent.overrides).sort(), ['grey_card', 'time_budget_s'])
  const { photo, x, y, width, height, reflectance } = sent.overrides.grey_card
  assert.match(photo, /^train_/)
  assert.deepEqual([width, height, reflectance], [4, 4, 0.85])
  // The click was at a quarter of the width and half of the height of 96 x 96 pixels.
  assert.ok(Math.abs(x + 2 - 24) <= 1 && Math.abs(y + 2 - 48) <= 1, `${x}, ${y}`)
  await page.unroute('**/v1/jobs')
}
