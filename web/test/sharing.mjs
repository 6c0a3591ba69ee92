// The page of a shared model, for people without a key.
import assert from 'node:assert/strict'

/** Copies the link of the shown model and opens it without a key. `open` opens a page; `audit` checks its accessibility. */
export async function sharedModel(page, open, audit) {
  await page.getByRole('button', { name: 'Copy a link to share' }).click()
  await page.getByText('The link to share was copied').waitFor()
  const link = await page.evaluate(() => navigator.clipboard.readText())
  assert.match(link, /\/share\/[0-9a-f-]{36}\?.*signature=/)
  const name = await page.getByRole('heading', { level: 1 }).innerText()
  const guest = await open({ viewport: { width: 1100, height: 800 } })
  const refused = []
  guest.on('response', (response) => response.status() >= 400 && refused.push(`${response.status()} ${response.url()}`))
  await guest.addInitScript(() => {
    addEventListener('relume-ready', () => (globalThis.isReady = true))
    addEventListener('relume-mode', ({ detail }) => (globalThis.mode = detail))
  })
  await guest.goto(link)
  await guest.waitForFunction(() => globalThis.isReady)
  assert.equal(await guest.title(), name)
  await guest.getByRole('heading', { level: 1, name, exact: true }).waitFor()
  assert.equal(await guest.evaluate(() => globalThis.mode), 'webgpu')
  const picture = () => guest.evaluate(async () => {
    const bytes = new Uint8Array(await (await document.querySelector('relume-viewer').snapshot()).arrayBuffer())
    return bytes.reduce((sum, byte) => (31 * sum + byte) >>> 0, bytes.length)
  })
  const before = await picture()
  await guest.getByRole('button', { name: 'night', exact: true }).click()
  assert.equal(await guest.getByRole('button', { name: 'night', exact: true }).getAttribute('aria-pressed'), 'true')
  await guest.waitForFunction(() => !document.querySelector('relume-viewer').shadowRoot.querySelector('.waiting'))
  assert.notEqual(await picture(), before, 'another light gives another picture')
  assert.deepEqual(refused, [], 'the link permits everything that the page requests')
  await audit(guest, 'share')
  await guest.setViewportSize({ width: 390, height: 844 })
  await audit(guest, 'phone-share')
  await guest.goto(link.replace(/.{8}$/, '00000000'))
  await guest.getByRole('heading', { name: 'This link shows no model' }).waitFor()
  await audit(guest, 'share-invalid')
  await guest.close()
}

/** The picture of the server stands in for WebGPU. */
export async function sharedWithoutWebGpu(page, open) {
  const link = await page.evaluate(() => navigator.clipboard.readText())
  const guest = await open({ viewport: { width: 800, height: 700 } })
  await guest.addInitScript(() => {
    Object.defineProperty(navigator, 'gpu', { value: undefined })
    addEventListener('relume-ready', () => (globalThis.isReady = true))
  })
  await guest.goto(link)
  await guest.waitForFunction(() => globalThis.isReady)
  const source = () => guest.evaluate(() => document.querySelector('relume-viewer').shadowRoot.querySelector('img').src)
  const before = await source()
  await guest.locator('relume-viewer').press('ArrowLeft')
  await guest.waitForFunction((src) => document.querySelector('relume-viewer').shadowRoot.querySelector('img').src !== src, before)
  await guest.close()
}
