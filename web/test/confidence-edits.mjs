// node test/confidence-edits.mjs: checks the colours of confidence, its request, the refusal of a model without it, and exports with fewer Gaussians.
import assert from 'node:assert/strict'
import { source } from './source.mjs'

const { coloured, colourOf, confidenceRequest, GRADIENT, isWithoutConfidence } = await source('confidence')
const { exportName, exportOf, exportWithin, hasGaussians } = await source('look')

// The scale: orange, pale, blue; between them linear, beyond the ends constant. The legend has the same colours.
const [low, middle, high] = [0, 0.5, 1].map(colourOf)
assert.deepEqual([low, middle, high], [[213, 72, 0], [247, 236, 190], [0, 98, 178]])
assert.deepEqual(colourOf(0.25), [230, 154, 95])
assert.deepEqual(colourOf(0.75), [124, 167, 184])
assert.deepEqual([colourOf(-1), colourOf(2)], [low, high])
assert.equal(GRADIENT, 'linear-gradient(to right, rgb(213 72 0), rgb(247 236 190), rgb(0 98 178))')

// The colours over a picture: where the picture has no model there are none, also with a confidence of 0.
const pixels = (...data) => ({ width: data.length, height: 1, data: Uint8ClampedArray.from(data.flat()) })
const grey = (...levels) => pixels(...levels.map((level) => [level, level, level, 255]))
const picture = pixels([9, 9, 9, 255], [9, 9, 9, 255], [9, 9, 9, 0], [9, 9, 9, 100])
const colours = coloured(grey(0, 255, 0, 255), picture)
assert.deepEqual([...colours.data], [...low, 204, ...high, 204, ...low, 0, ...high, 80])
assert.deepEqual([colours.width, colours.height], [4, 1])
assert.throws(() => coloured(grey(0), picture), /size/)

// The request has the camera alone: another light needs no other confidence.
const camera = { look_at: { eye: [3, 0, 1], target: [0, 0, 0], fov_y_deg: 40 } }
const request = { camera, width: 640, height: 480, environment: { builtin: 'studio' }, materials: [{ material: 0, roughness: 0 }], lamps: [], outputs: ['rgb'], background: 'transparent' }
assert.deepEqual(confidenceRequest(request), { camera, width: 640, height: 480, outputs: ['confidence'] })

// A model without confidence, and other refusals.
const problem = (pointer) => ({ type: 'urn:relume:problem:invalid-field', title: 'A field is invalid', status: 422, request_id: '', errors: [{ pointer, detail: '' }] })
assert.ok(isWithoutConfidence(422, problem('/outputs')))
for (const [status, refused] of [[422, problem('/width')], [422, null], [503, problem('/outputs')], [422, { ...problem(''), errors: undefined }]]) assert.ok(!isWithoutConfidence(status, refused))

// Exports of Gaussians with a limit; others have none.
const look = { light: 'studio', rotation: 0, exposure: 0, background: 'transparent', output: 'rgb' }
const made = (what) => exportOf(what, look, undefined, ['studio'], 3, 64)
for (const what of ['gltf', 'usdz', 'ply', 'relit']) {
  assert.ok(hasGaussians(what))
  assert.deepEqual(exportWithin(made(what), 5000), { ...made(what), max_splats: 5000 }, what)
  assert.deepEqual(exportWithin(made(what), undefined), made(what), what)
}
for (const what of ['video', 'frames', 'layers', 'mesh']) {
  assert.ok(!hasGaussians(what))
  assert.deepEqual(exportWithin(made(what), 5000), made(what), what)
}
const named = (request) => exportName({ kind: request.kind, request, progress: { done: 0, total: 1 } }, () => 'studio')
assert.equal(named(exportWithin(made('ply'), 5000)), 'PLY, relightable, at most 5000 Gaussians')
assert.equal(named({ ...made('gltf'), max_splats: null }), 'glTF with Gaussians')
console.log('confidence: colours, requests and refusals; exports with fewer Gaussians')
