// The page /docs: the description of the API, a request with a key, and its code.
import assert from 'node:assert/strict'

export async function documentedApi(page, base, key) {
  await page.goto(`${base}/docs`)
  const operation = page.locator('.opblock-get').filter({ has: page.locator('[data-path="/v1/models"]') })
  await operation.waitFor()
  assert.ok((await page.locator('.opblock').count()) > 60, 'all operations are listed')
  await page.locator('.btn.authorize').first().click()
  await page.getByLabel('auth-bearer-value').fill(key)
  await page.getByRole('button', { name: 'Apply credentials' }).click()
  await page.locator('.btn-done').click()
  await operation.locator('button.opblock-summary-control').click()
  await operation.getByRole('button', { name: 'Execute' }).click()
  await operation.locator('.live-responses-table .response-col_status').filter({ hasText: '200' }).waitFor()
  for (const [name, code] of [['curl', "curl -X 'GET'"], ['Python', 'requests.request('], ['TypeScript', 'await fetch(']]) {
    await operation.locator('.request-snippets h4').filter({ hasText: new RegExp(`^${name}$`) }).click()
    const shown = await operation.locator('.request-snippets .microlight').innerText()
    assert.ok(shown.includes(code) && shown.includes(`Bearer ${key}`) && shown.includes('/v1/models'), `${name}: ${shown}`)
  }
  const filterIn = async (colorScheme) => {
    await page.emulateMedia({ colorScheme })
    return page.evaluate(() => getComputedStyle(document.documentElement).filter)
  }
  assert.equal(await filterIn('light'), 'none')
  assert.match(await filterIn('dark'), /invert/)
}
