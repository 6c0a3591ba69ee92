// node test/delight-edits.mjs: checks exports of photographs without their light: their requests and their names.
import assert from 'node:assert/strict'
import { source } from './source.mjs'

const { exportDelight, exportName, exportOf, exportWithin, hasGaussians, TAKEN } = await source('look')
const { exportStaged } = await source('lamps')
const { exportWith } = await source('materials')

// The request has its own fields alone: no materials, no lamps and no number of Gaussians.
const look = { light: 'studio', rotation: 0, exposure: 0, background: 'transparent', output: 'rgb' }
const lamp = { shape: 'point', position: [1, 2, 3], radius: 0, intensity: 1, kelvin: 3200 }
const staging = { lamps: [{ lamp, isOn: true }], isSharp: true, floor: undefined, height: undefined }
const made = (what, format, side) => {
  const plain = exportOf(what, look, undefined, ['studio'], 3, 64)
  return exportDelight(exportWithin(exportStaged(exportWith(plain, [{ material: 0, roughness: 0 }], { builtin: 'studio' }), staging), 5000), format, side)
}
assert.ok(!hasGaussians('delight'))
assert.deepEqual(made('delight', 'exr', undefined), { kind: 'delight', format: 'exr' })
assert.deepEqual(made('delight', 'png', 1024), { kind: 'delight', format: 'png', resolution: 1024 })
for (const what of Object.keys(TAKEN)) if (what !== 'delight') assert.ok(!('resolution' in made(what, 'png', 1024)) && made(what, 'png', 1024).format !== 'png', what)

// Names in the list of exports.
const named = (request) => exportName({ kind: 'delight', request, progress: { done: 0, total: 24 } }, () => 'studio')
assert.equal(named({ kind: 'delight' }), 'Photographs without their light, EXR')
assert.equal(named({ kind: 'delight', format: 'png', resolution: 1024, photographs: null }), 'Photographs without their light, PNG, longest side 1024 px')
assert.equal(named({ kind: 'delight', format: 'exr', photographs: ['a.jpg', 'b.jpg'] }), 'Photographs without their light, EXR, 2 chosen')
assert.equal(named(null), 'Photographs without their light')
console.log('photographs without their light: requests and names')
