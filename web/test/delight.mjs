// The export of photographs without their light.
import assert from 'node:assert/strict'

/** Makes the layers as EXR and as PNG. `audit` checks the accessibility of the page. */
export async function delitPhotographs(page, audit) {
  const side = page.getByLabel('Longest side, px')
  const make = async () => {
    const sent = page.waitForRequest((request) => request.method() === 'POST' && request.url().endsWith('/exports'))
    await page.getByRole('button', { name: 'Make it' }).click()
    return JSON.parse((await sent).postData())
  }
  await page.getByLabel('What', { exact: true }).selectOption('delight')
  assert.equal(await page.getByLabel('Gaussians at most (optional)').count(), 0)
  assert.deepEqual(await make(), { kind: 'delight', format: 'exr' })
  await page.getByRole('button', { name: '↓ Photographs without their light, EXR', exact: true }).waitFor()
  await page.getByLabel('Format', { exact: true }).selectOption('png')
  await page.getByText('The PNG files have 8 bits.').waitFor()
  await side.fill('32')
  await audit(page, 'delight')
  assert.deepEqual(await make(), { kind: 'delight', format: 'png', resolution: 32 })
  const made = 'Photographs without their light, PNG, longest side 32 px'
  await page.getByRole('button', { name: `↓ ${made}` }).waitFor()
  for (const name of [made, 'Photographs without their light, EXR']) {
    await page.getByRole('button', { name: `Delete ${name}`, exact: true }).click()
    await page.getByRole('button', { name: `↓ ${name}`, exact: true }).waitFor({ state: 'detached' })
  }
  await side.fill('')

  // The capture was deleted: the program has to do it.
  await page.route('**/exports', (route) => (route.request().method() === 'POST' ? route.fulfill({ status: 409, contentType: 'application/problem+json', body: JSON.stringify({ type: 'urn:relume:problem:capture-deleted', title: '', status: 409, request_id: '' }) }) : route.continue()))
  await page.getByRole('button', { name: 'Make it' }).click()
  await page.getByRole('alert').getByText('Download the model, then use the program relume with the photographs.').waitFor()
  await page.unroute('**/exports')
  await page.getByLabel('What', { exact: true }).selectOption('frames')
}
