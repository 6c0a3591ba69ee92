// node test/lamp-edits.mjs: checks lamps, their text in the address, the requests with them, the projection of their positions, and the picture on a ground.
import assert from 'node:assert/strict'
import { source } from './source.mjs'

const { BARE, coloured, exportStaged, lampText, newLamp, readLamp, readStaging, reshaped, shining, staged, writtenStaging } = await source('lamps')
const { depthAt, projected, unprojected } = await source('projection')
const { groundRequest, lampLightRequest, onGround } = await source('ground')
const { exportName, exportOf } = await source('look')

// A new lamp: a white surface at its target is half as bright as a map of radiance 1.
const bulb = newLamp([2, -1e-17, 0.12345], [0, 0, 0])
assert.deepEqual(bulb, { shape: 'point', position: [2, 0, 0.123], radius: 0.2, intensity: 6.3, kelvin: 3200 })

// Each shape has the fields that the API takes for it.
const fields = (lamp) => Object.keys(lamp).sort().join()
const spot = reshaped(bulb, 'spot', [0, 0, 1])
assert.equal(fields(spot), 'cone_deg,intensity,kelvin,position,radius,shape,target')
assert.deepEqual([spot.cone_deg, spot.target], [45, [0, 0, 1]])
const box = reshaped(spot, 'rectangle', [9, 9, 9])
assert.equal(fields(box), 'intensity,kelvin,position,shape,size,target')
assert.deepEqual([box.size, box.target], [[0.8, 0.4], [0, 0, 1]], 'the target stays')
assert.equal(fields(reshaped(box, 'disc', [0, 0, 0])), 'intensity,kelvin,position,radius,shape,target')
assert.equal(reshaped(box, 'disc', [0, 0, 0]).radius, 0.2)
assert.equal(fields(reshaped(box, 'point', [0, 0, 0])), 'intensity,kelvin,position,radius,shape')
assert.ok(reshaped({ ...bulb, radius: 0 }, 'rectangle', [0, 0, 0]).size.every((side) => side > 0), 'a rectangle has a size')

// Either a colour temperature or a colour.
assert.equal(fields(coloured(bulb, { colour: '#ff0000' })), 'colour,intensity,position,radius,shape')
assert.equal(fields(coloured({ ...bulb, colour: '#ff0000' }, { kelvin: 5000 })), 'intensity,kelvin,position,radius,shape')

// Lamps as text: that of the option --lamp.
assert.equal(lampText(spot), 'spot position=2,0,0.123 target=0,0,1 radius=0.2 cone=45 kelvin=3200 intensity=6.3')
for (const lamp of [bulb, spot, box, coloured(box, { colour: '#ff8800' }), reshaped(box, 'disc', [0, 0, 0])]) assert.deepEqual(readLamp(lampText(lamp)), lamp)
for (const text of ['', 'sun position=1,2,3', 'point', 'point position=1,2', 'point position=1,x,3', 'point position=1,,3', 'spot position=1,2,3', 'disc position=1,2,3 target=1,2,3', 'rectangle position=1,2,3 target=0,0,0', 'rectangle position=1,2,3 target=0,0,0 size=0,1']) {
  assert.equal(readLamp(text), undefined, text)
}
assert.deepEqual(readLamp('point position=1,2,3 kelvin=99 intensity=-1 colour=red'), { shape: 'point', position: [1, 2, 3], radius: 0, kelvin: 1700, intensity: 0 })

// The address.
const staging = { lamps: [{ lamp: bulb, isOn: true }, { lamp: box, isOn: false }], isSharp: true, floor: '#808080', height: -0.5 }
const query = writtenStaging(staging)
assert.deepEqual(readStaging(new URLSearchParams(new URLSearchParams(query).toString())), staging)
assert.deepEqual(writtenStaging(BARE), {})
assert.deepEqual(readStaging(new URLSearchParams('floor=red&ground=deep&lamps=none')), BARE)
assert.equal(readStaging(new URLSearchParams({ lamps: Array(9).fill(lampText(bulb)).join(';') })).lamps.length, 4)
assert.equal(readStaging(new URLSearchParams('ground=0')).height, 0)

// Requests: only lamps that shine; without lamps as before.
const light = { builtin: 'studio', rotation_deg: 20, exposure_ev: 1 }
const picture = { camera: { look_at: { eye: [3, 0, 1], target: [0, 0, 0], fov_y_deg: 40 } }, width: 640, height: 480, environment: light, outputs: ['rgb'], background: 'environment' }
assert.deepEqual(shining(staging), [bulb])
assert.deepEqual(staged(picture, BARE), picture)
assert.deepEqual(staged(picture, staging), { ...picture, lamps: [bulb], tier: 'high', background: 'transparent' })
const edits = [{ material: 0, roughness: 0 }]
const factor = groundRequest({ ...staged({ ...picture, materials: edits }, staging) }, 'bounce', 0)
assert.deepEqual(factor, { camera: picture.camera, width: 640, height: 480, environment: { ...light, exposure_ev: 0 }, materials: edits, outputs: ['bounce'], ground_height: 0 })
assert.ok(!('ground_height' in groundRequest(picture, 'shadow', undefined)))
const lampLight = lampLightRequest({ ...picture, materials: edits }, [bulb], 0)
assert.deepEqual(lampLight, { camera: picture.camera, width: 640, height: 480, materials: edits, lamps: [{ ...bulb, intensity: 6.3 / 4 }], outputs: ['lamp_light'], ground_height: 0 })

// Exports: pictures and layers with lamps, other files without.
const look = { light: 'studio', rotation: 0, exposure: 0, background: 'transparent', output: 'rgb' }
const made = (what, given = staging) => exportStaged(exportOf(what, look, undefined, ['studio'], 3, 64), given)
assert.deepEqual([made('frames').lamps, made('frames').tier, made('frames').ground_height], [[bulb], 'high', undefined])
assert.deepEqual(made('frames', BARE), exportOf('frames', look, undefined, ['studio'], 3, 64))
const layers = made('layers')
assert.deepEqual([layers.format, layers.package, layers.ground_height, layers.outputs], ['exr', 'zip', -0.5, ['rgb', 'depth', 'shadow', 'bounce', 'contact', 'lamp_light', 'lamp_shadow']])
assert.deepEqual(made('layers', BARE).outputs, ['rgb', 'depth', 'shadow', 'bounce', 'contact'])
for (const what of ['gltf', 'usdz', 'ply', 'relit', 'mesh']) assert.deepEqual(made(what), made(what, BARE), what)
const named = (request) => exportName({ kind: request.kind, request, progress: { done: 0, total: 3 } }, () => 'studio')
assert.equal(named(layers), 'Turntable, layers, 3 frames, 64 × 64 px, studio, with lamps')
assert.equal(named(made('mesh')), 'Mesh with textures')

// The projection: the target is in the middle, right is +y for a camera on the +x side, up is up, and both directions agree.
const camera = { eye: [3, 0, 1], target: [0, 0, 0], fov_y_deg: 40 }
const near = (a, b) => a.every((value, k) => Math.abs(value - b[k]) < 1e-9)
const middle = projected(camera, 4 / 3, [0, 0, 0])
assert.ok(near(middle.at, [0.5, 0.5]) && Math.abs(middle.depth - Math.sqrt(10)) < 1e-9)
assert.ok(projected(camera, 4 / 3, [0, 0.5, 0]).at[0] > 0.6 && projected(camera, 4 / 3, [0, 0, 0.5]).at[1] < 0.4)
assert.equal(projected(camera, 4 / 3, [4, 0, 1]), undefined, 'behind the camera')
for (const point of [[0.3, -0.7, 0.2], [1, 2, 3]]) assert.ok(near(unprojected(camera, 4 / 3, projected(camera, 4 / 3, point)), point))
// The upper edge of the picture is half the field of view above its middle.
const { at: [, top] } = projected({ eye: [0, -1, 0], target: [0, 0, 0], fov_y_deg: 90 }, 2, [0, 0, 1])
assert.ok(Math.abs(top) < 1e-9)
const depths = { width: 2, height: 1, levels: Uint8Array.of(51, 255), near: 1, far: 6 }
assert.deepEqual([depthAt(depths, [0, 0]), depthAt(depths, [0.9, 1]), depthAt(depths, [1, 1])], [2, undefined, undefined])

// The picture on a ground, beside the same in floating point.
const decode = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
const encode = (v) => 255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055)
const pixels = (...data) => ({ width: data.length, height: 1, data: Uint8ClampedArray.from(data.flat()) })
const rgba = [[200, 100, 50, 255], [200, 100, 50, 102], [0, 0, 0, 0], [0, 0, 0, 0]]
const [shadow, bounce] = [[[10, 10, 10, 255], [90, 90, 90, 255], [128, 140, 150, 255], [255, 255, 255, 255]], [[99, 99, 99, 255], [10, 20, 30, 255], [30, 0, 0, 255], [0, 0, 0, 255]]]
const factors = { shadow: pixels(...shadow), bounce: pixels(...bounce) }
const result = onGround(pixels(...rgba), factors, '#c08040')
const floor = [0xc0, 0x80, 0x40]
rgba.forEach(([r, g, b, a], i) => [r, g, b].forEach((value, c) => {
  const level = (v) => decode(v / 255)
  const ground = level(floor[c]) * (level(shadow[i][c]) + level(bounce[i][c]))
  const expected = encode(level(value) * (a / 255) + ground * (1 - a / 255))
  assert.ok(Math.abs(result.data[4 * i + c] - expected) < 1.5, `pixel ${i}, channel ${c}: ${result.data[4 * i + c]}, not ${expected}`)
}))
assert.deepEqual([...result.data.slice(0, 4)], rgba[0], 'no ground before the model')
assert.deepEqual([...result.data.slice(12)], [...floor, 255], 'the colour of the ground where it has no shadow')
const level = 30
const lamps = pixels(...rgba.map(() => [level, level, level, 255]))
const lit = onGround(pixels(...rgba), { ...factors, lampLight: lamps }, '#c08040')
floor.forEach((value, c) => assert.ok(Math.abs(lit.data[12 + c] - encode(decode(value / 255) * (1 + 4 * decode(level / 255)))) < 1.5, 'lamps light the ground'))
assert.throws(() => onGround(pixels(...rgba), { ...factors, shadow: pixels([0, 0, 0, 255]) }, '#000000'), /size/)
assert.throws(() => onGround(pixels(...rgba), { ...factors, lampLight: pixels([0, 0, 0, 255]) }, '#000000'), /size/)
console.log('lamps and ground: texts, requests, projection and composition')
