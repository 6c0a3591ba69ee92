// The page of web.mjs for PlayCanvas, with WebGL.
import * as pc from 'playcanvas'

function start(side) {
  const canvas = document.querySelector('canvas')
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: true, preserveDrawingBuffer: true, alpha: false } })
  app.setCanvasFillMode(pc.FILLMODE_NONE)
  app.setCanvasResolution(pc.RESOLUTION_FIXED, side, side)
  app.start()
  return { canvas, app }
}

const load = (app, url, kind, data) =>
  new Promise((resolve, reject) => {
    const asset = new pc.Asset(url, kind, { url, filename: url.split('/').pop() }, data)
    asset.on('load', () => resolve(asset))
    asset.on('error', (message) => reject(new Error(message)))
    app.assets.add(asset)
    app.assets.load(asset)
  })

/** The camera of a job (camera to world, +Z up, row by row) for a scene with +Y up. */
function turnCamera(entity, { matrix: [x, y, z], fov }) {
  const columns = [0, 1, 2, 3].flatMap((i) => [x[i], z[i], -y[i], i === 3 ? 1 : 0])
  const matrix = new pc.Mat4().set(columns)
  entity.setPosition(matrix.getTranslation())
  entity.setRotation(new pc.Quat().setFromMat4(matrix))
  entity.camera.fov = fov
}

async function lightBy(app, { light, sun, turn = -90 }) {
  app.scene.ambientLight = new pc.Color(0, 0, 0)
  if (light) {
    const { resource } = await load(app, light, 'texture', { projection: 'equirect', mipmaps: false })
    const source = pc.EnvLighting.generateLightingSource(resource)
    app.scene.envAtlas = pc.EnvLighting.generateAtlas(source)
    // With this turn the centre of the map is +X of the file.
    app.scene.skyboxRotation = new pc.Quat().setFromEulerAngles(0, turn, 0)
  }
  if (!sun) return
  const lamp = new pc.Entity('sun')
  // A light of intensity 1 has the irradiance pi: PlayCanvas leaves out the division by pi.
  lamp.addComponent('light', { type: 'directional', intensity: 1, castShadows: true, shadowResolution: 2048, shadowDistance: 8, normalOffsetBias: 0.05 })
  app.root.addChild(lamp)
  lamp.setPosition(4 * sun[0], 4 * sun[2], -4 * sun[1])
  // A light shines along its negative y axis.
  lamp.setRotation(new pc.Quat().setFromDirections(new pc.Vec3(0, 1, 0), new pc.Vec3(sun[0], sun[2], -sun[1])))
}

async function pictures({ canvas, app }, job, frames) {
  const eye = new pc.Entity('eye')
  eye.addComponent('camera', { clearColor: new pc.Color(1, 1, 1), nearClip: 0.05, farClip: 50, toneMapping: pc.TONEMAP_NONE, gammaCorrection: pc.GAMMA_SRGB })
  eye.camera.layers = eye.camera.layers.filter((id) => id !== pc.LAYERID_SKYBOX)
  app.root.addChild(eye)
  const found = []
  for (const camera of job.cameras) {
    turnCamera(eye, camera)
    for (let frame = 0; frame < frames; frame++) await new Promise((resolve) => app.once('frameend', resolve))
    found.push(canvas.toDataURL('image/png'))
  }
  return found
}

export async function mesh(job) {
  const { canvas, app } = start(job.side)
  await lightBy(app, job)
  const { resource } = await load(app, job.file, 'container')
  app.root.addChild(resource.instantiateRenderEntity({ castShadows: true, receiveShadows: true }))
  return pictures({ canvas, app }, job, 4)
}

/** A .ply has the axes of the capture, so it is turned to +Y up. */
async function addSplats(app, file) {
  const isPly = file.endsWith('.ply')
  const asset = await load(app, file, isPly ? 'gsplat' : 'container')
  if (!isPly) {
    app.root.addChild(asset.resource.instantiateRenderEntity())
    return asset.resource
  }
  const entity = new pc.Entity('splats')
  entity.addComponent('gsplat', { asset })
  entity.setLocalEulerAngles(-90, 0, 0)
  app.root.addChild(entity)
  return asset.resource
}

export async function splats(job) {
  const { canvas, app } = start(job.side)
  await addSplats(app, job.file)
  return pictures({ canvas, app }, job, 20)
}

export async function kept({ file }) {
  const { app } = start(64)
  const resource = await addSplats(app, file)
  const splats = resource.gsplatData ? resource : resource.gsplats?.flat().find(Boolean)
  const data = (splats?.resource ?? splats)?.gsplatData
  if (!data) return { type: Object.keys(resource).join(' '), count: 0, attributes: [] }
  return { type: 'gsplat', count: data.numSplats, attributes: data.getElement('vertex').properties.map((property) => property.name) }
}
