// node test/material-edits.mjs: checks the list of changes of materials, the requests with them, and the choice of a material at a pixel.
import assert from 'node:assert/strict'
import { source } from './source.mjs'

const { afterMerges, brightest, changed, editsFile, exportWith, hasMaterials, maskRequest, merged, mergesOf, undone, valuesOf } = await source('materials')
const { SerialQueue } = await source('serial-queue')
const { exportName } = await source('look')

const material = (number) => ({ material: number, colour: '#8a5a33', albedo: [0.25, 0.1, 0.03], share: 0.5, roughness: 0.6, metalness: 0.1 })
const [first, second] = [material(0), material(1)]

// The list of changes: one item for each changed material, in the order of the numbers.
const blue = changed([], second, { colour: '#224488' })
assert.deepEqual(blue, [{ material: 1, colour: '#224488' }])
const both = changed(changed(blue, first, { roughness: 0 }), second, { metalness: 1 })
assert.deepEqual(both, [{ material: 0, roughness: 0 }, { material: 1, colour: '#224488', metalness: 1 }])
assert.deepEqual(blue, [{ material: 1, colour: '#224488' }], 'the previous list stays')
assert.deepEqual(valuesOf(second, both), { colour: '#224488', roughness: 0.6, metalness: 1 })
assert.deepEqual(valuesOf(first, both), { colour: '#8a5a33', roughness: 0, metalness: 0.1 })
assert.deepEqual(undone(both, 1), [{ material: 0, roughness: 0 }])
assert.deepEqual(changed(blue, second, { colour: second.colour }), [], 'the colour of the material is no change')
assert.deepEqual(changed(both, second, { colour: second.colour })[1], { material: 1, metalness: 1 })
assert.deepEqual(changed([], first, { roughness: first.roughness }), [{ material: 0, roughness: 0.6 }], 'a constant roughness is a change')
assert.equal(editsFile(blue), '[\n  {\n    "material": 1,\n    "colour": "#224488"\n  }\n]\n')

// Merges: a merged material has no other change, and no merge leads to a merged material.
const joined = merged(merged(both, 2, 1), 1, 0)
assert.deepEqual(joined, [{ material: 0, roughness: 0 }, { material: 1, into: 0 }, { material: 2, into: 0 }])
assert.deepEqual(mergesOf(joined), joined.slice(1))
assert.deepEqual(undone(joined, 0), [], 'undoing a material undoes the merges into it')
const parts = [{ ...first, share: 0.6, roughness: 0.2 }, { ...second, share: 0.2, albedo: [0.85, 0.1, 0.03], roughness: 0.6 }, { ...material(2), share: 0.2 }]
const [whole, rest] = afterMerges(parts, [{ material: 1, into: 0 }])
assert.deepEqual([whole.material, rest], [0, parts[2]])
assert.ok([whole.share - 0.8, whole.roughness - 0.3, whole.albedo[0] - 0.4].every((difference) => Math.abs(difference) < 1e-9), JSON.stringify(whole))
assert.equal(whole.colour, '#aa5930')
assert.deepEqual(afterMerges(parts, both), parts, 'without merges')

// Models of colour alone.
assert.ok(hasMaterials({}) && hasMaterials({ config: { warm_up: 0.3 }, imported: { materials: true } }))
assert.ok(!hasMaterials({ config: { warm_up: 1 } }) && !hasMaterials({ imported: { materials: false } }))

// Exports: without changes as before; kinds with the colours of the photographs are lit.
const light = { builtin: 'studio' }
for (const kind of ['frames', 'ply', 'gltf', 'usdz', 'mesh']) assert.deepEqual(exportWith({ kind }, [], light), { kind })
for (const kind of ['frames', 'ply', 'mesh']) assert.deepEqual(exportWith({ kind }, blue, light), { kind, materials: blue })
for (const kind of ['gltf', 'usdz']) assert.deepEqual(exportWith({ kind }, blue, light), { kind, environment: light, materials: blue })
const named = (materials) => exportName({ kind: 'mesh', request: { kind: 'mesh', materials }, progress: { done: 0, total: 1 } }, () => '')
assert.equal(named([]), 'Mesh with textures')
assert.equal(named(blue), 'Mesh with textures, materials changed')

// A mask has the camera and the sides of the picture, but not its light and its changes.
const picture = { camera: { look_at: { eye: [3, 0, 1], target: [0, 0, 0], fov_y_deg: 40 } }, width: 640, height: 480, environment: light, materials: blue }
const three = [first, second, material(2)]
const pair = [{ material: 0, roughness: 1, metalness: 0 }, { material: 1, roughness: 0, metalness: 1 }, { material: 2, roughness: 0, metalness: 0 }]
const last = [{ material: 0, roughness: 0, metalness: 0 }, { material: 1, roughness: 0, metalness: 0 }, { material: 2, roughness: 1, metalness: 0 }]
for (const [number, output, materials] of [[0, 'roughness', pair], [1, 'metallic', pair], [2, 'roughness', last]]) {
  assert.deepEqual(maskRequest(picture, three, number, []), { camera: picture.camera, width: 160, height: 120, outputs: [output], materials })
}

const merge = { material: 1, into: 0 }
assert.deepEqual(maskRequest(picture, [first, material(2)], 2, [merge]).materials, [merge, { material: 0, roughness: 1, metalness: 0 }, { material: 2, roughness: 0, metalness: 1 }])

// The material at a pixel: the one with the largest share, none where there is no surface, and the edges of the picture.
const mask = (...values) => ({ width: 3, height: 2, values: Uint8Array.from(values) })
const masks = [mask(255, 100, 0, 0, 0, 60), mask(0, 155, 0, 0, 255, 70), mask(0, 0, 0, 3, 0, 125)]
assert.deepEqual([[0.1, 0.1], [0.5, 0.2], [0.9, 0.2], [0.1, 0.9], [0.5, 0.7], [0.9, 0.9]].map((at) => brightest(masks, at)), [0, 1, undefined, undefined, 1, 2])
assert.equal(brightest(masks, [1, 1]), 2)
assert.equal(brightest(masks, [0, 0]), 0)
assert.equal(brightest([], [0.5, 0.5]), undefined)

// One job at a time, also after one that fails; an urgent one overtakes those that wait.
const queue = new SerialQueue()
const order = []
const job = (name, { fails = false, isUrgent = false } = {}) => queue.add(async () => {
  order.push(`${name} begins`)
  await new Promise((done) => setTimeout(done, 5))
  order.push(`${name} ends`)
  if (fails) throw new Error(name)
  return name
}, isUrgent)
const results = await Promise.allSettled([job('a'), job('b', { fails: true }), job('c'), job('d', { isUrgent: true })])
assert.deepEqual(results.map(({ status }) => status), ['fulfilled', 'rejected', 'fulfilled', 'fulfilled'])
assert.deepEqual(order, ['a', 'd', 'b', 'c'].flatMap((name) => [`${name} begins`, `${name} ends`]))
console.log('changes of materials: lists, requests and choice at a pixel')
