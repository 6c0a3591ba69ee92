// node test/next-photographs-edits.mjs: checks the places for further photographs: their directions in words, their positions, whether a view is at one, and their file.
import assert from 'node:assert/strict'
import { source } from './source.mjs'

const { isAt, placesFile, positionOf, spokenDirection, thumbnailOf } = await source('next-photographs')
const { distanceOf, projected } = await source('projection')

// Directions in words: an azimuth counts counter-clockwise seen from above, so 90 is at the right of someone who looks at the subject from the first photograph.
const place = (azimuth_deg, elevation_deg) => ({ azimuth_deg, elevation_deg })
for (const [azimuth, elevation, words] of [
  [320, 15.2, '40° to the left of the first photograph, 15° up'],
  [90, -3.3e-15, '90° to the right of the first photograph, level'],
  [224.99999999999997, -20, '135° to the left of the first photograph, 20° down'],
  [179.6, 0, 'opposite the first photograph, level'],
  [359.8, 40, 'on the side of the first photograph, 40° up'],
  [0, 0, 'on the side of the first photograph, level'],
  [77, 90, 'from straight above'],
  [77, -89.9, 'from straight below'],
]) assert.equal(spokenDirection(place(azimuth, elevation)), words)
const first = { eye: [4, 0, 0], target: [0, 0, 0], fov_y_deg: 60 }
assert.ok(projected(first, 1, [0, 1, 0]).at[0] > 0.5, 'the azimuth 90 is at the right of a camera at the azimuth 0')

// From the least distance all points are in the picture, and one is at the given share of its half sides.
const points = [[4, 0, 0], [-2, 3, 1], [0, -4, 0], [1, 1, -3]]
for (const aspect of [4 / 3, 0.6]) {
  const distance = distanceOf({ ...first, eye: [2, 1, 2] }, aspect, points, 0.9)
  const eye = [2, 1, 2].map((value) => (value / 3) * distance)
  const far = points.map((point) => Math.max(...projected({ ...first, eye }, aspect, point).at.map((share) => Math.abs(2 * share - 1))))
  assert.ok(Math.abs(Math.max(...far) - 0.9) < 1e-9, `${far}`)
}

// The position is the last column of the matrix.
const camera = { camera_to_world: [[1, 0, 0, 7], [0, 1, 0, 8], [0, 0, 1, 9], [0, 0, 0, 1]], intrinsics: { fx: 1, fy: 1, cx: 0, cy: 0 } }
assert.deepEqual(positionOf({ camera }), [7, 8, 9])
assert.equal(positionOf({ camera: { look_at: {} } }), undefined)

// A view is at a place if it has its direction, across 0 and 360 and near the poles, where views end at 89.
assert.ok(isAt(place(359.5, 10), { azimuth: 0.4, elevation: 10.5 }))
assert.ok(isAt(place(10, 90), { azimuth: 200, elevation: 89 }))
assert.ok(isAt(place(330, 0), { azimuth: -30, elevation: 0 }))
assert.ok(!isAt(place(30, 10), { azimuth: 33, elevation: 10 }))
assert.ok(!isAt(place(30, 10), { azimuth: 30, elevation: 13 }))

assert.equal(thumbnailOf('a', place(224.99999999999997, -3.2e-15)), 'v1/models/a/thumbnail?azimuth=225&elevation=0&size=96')

// The file has the whole answer, so it is a camera path.
const answer = { cameras: [{ camera, width: 512, height: 512, candidate: 3, azimuth_deg: 1, elevation_deg: 2, nearest_deg: 3, lack_of_confidence: 0.5 }] }
assert.deepEqual(JSON.parse(placesFile(answer)), answer)
console.log('next photographs: words, positions, views and file')
