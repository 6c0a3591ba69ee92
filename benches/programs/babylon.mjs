// The page of web.mjs for Babylon.js.
import * as BABYLON from '@babylonjs/core'
import '@babylonjs/loaders/glTF/index.js'
import '@babylonjs/loaders/SPLAT/index.js'

function start(side) {
  const canvas = document.querySelector('canvas')
  Object.assign(canvas, { width: side, height: side })
  const engine = new BABYLON.Engine(canvas, true, { preserveDrawingBuffer: true })
  const scene = new BABYLON.Scene(engine)
  // Without this the loader mirrors a glTF file, and a camera of the file's axes does not fit.
  scene.useRightHandedSystem = true
  scene.clearColor = new BABYLON.Color4(1, 1, 1, 1)
  return { canvas, scene }
}

/** The camera of a job (camera to world, +Z up, row by row) for a scene with +Y up. */
function cameraOf({ matrix, fov }, scene) {
  const column = (i) => new BABYLON.Vector3(matrix[0][i], matrix[2][i], -matrix[1][i])
  const camera = new BABYLON.FreeCamera('camera', column(3), scene)
  camera.upVector = column(1)
  camera.setTarget(column(3).subtract(column(2)))
  camera.fov = (fov * Math.PI) / 180
  Object.assign(camera, { minZ: 0.05, maxZ: 50 })
  return camera
}

async function lightBy(scene, { light, sun, turn = 90 }) {
  if (light) {
    const map = await new Promise((resolve, reject) => {
      const made = new BABYLON.HDRCubeTexture(light, scene, 256, false, true, false, true, () => resolve(made), (message) => reject(new Error(message)))
    })
    // With this turn the centre of the map is +X of the file.
    map.rotationY = (turn * Math.PI) / 180
    scene.environmentTexture = map
  }
  if (!sun) return null
  const lamp = new BABYLON.DirectionalLight('sun', new BABYLON.Vector3(-sun[0], -sun[2], sun[1]), scene)
  lamp.position = lamp.direction.scale(-4)
  lamp.intensity = Math.PI
  const shadows = new BABYLON.ShadowGenerator(2048, lamp)
  shadows.usePercentageCloserFiltering = true
  shadows.normalBias = 0.02
  return shadows
}

async function pictures({ canvas, scene }, job, frames) {
  const found = []
  for (const camera of job.cameras) {
    scene.activeCamera = cameraOf(camera, scene)
    await scene.whenReadyAsync()
    for (let frame = 0; frame < frames; frame++) {
      scene.render()
      await new Promise((resolve) => setTimeout(resolve, 100))
    }
    scene.render()
    found.push(canvas.toDataURL('image/png'))
  }
  return found
}

export async function mesh(job) {
  const { canvas, scene } = start(job.side)
  const shadows = await lightBy(scene, job)
  const { meshes } = await BABYLON.ImportMeshAsync(job.file, scene)
  for (const part of meshes) {
    part.receiveShadows = true
    shadows?.addShadowCaster(part)
  }
  return pictures({ canvas, scene }, job, 2)
}

export async function splats(job) {
  const { canvas, scene } = start(job.side)
  await BABYLON.ImportMeshAsync(job.file, scene)
  return pictures({ canvas, scene }, job, 10)
}

export async function kept({ file }) {
  const { scene } = start(64)
  const { meshes } = await BABYLON.ImportMeshAsync(file, scene)
  const mesh = meshes.find((part) => part.getTotalVertices() > 0) ?? meshes[0]
  const splats = meshes.find((part) => part.getClassName().startsWith('GaussianSplatting'))
  const found = splats ?? mesh
  return { type: found.getClassName(), count: splats?.splatCount ?? found.getTotalVertices(), attributes: found.getVerticesDataKinds() }
}
