import type { Camera } from '../camera'
import { DepthSort } from '../sort'
import { Uniform, code } from './kernels'
import { BLENDED, type Pipelines, type Ready } from './pipelines'
import type { SceneLight, SceneModel } from './scene'

/** Width and height of a tile of the engine, pixels. */
const TILE = 16
/** Threads of a workgroup of every kernel. */
const GROUP = 256
/** Bytes of a splat and of an attribute row of the engine. */
const SPLAT_BYTES = 64
const ROW_BYTES = 64

/** For each output: the blended quantity (`drawing.what` of splats.wgsl) and the display mode (`present.what` of present.wgsl). */
const OUTPUTS: Record<string, { blended: number; shown: number }> = {
  rgb: { blended: 0, shown: 0 },
  albedo: { blended: 1, shown: 1 },
  normal: { blended: 2, shown: 2 },
  roughness: { blended: 3, shown: 3 },
  metalness: { blended: 4, shown: 3 },
  depth: { blended: 5, shown: 4 },
  // The painter blends the normals first and computes `ao` from them.
  ao: { blended: 2, shown: 5 },
}

/** The display settings of a picture. */
export interface Finish {
  output: string
  /** Stops. */
  exposure: number
  /** Display-referred colour, 0 to 1; undefined: transparent. */
  background: [number, number, number] | undefined
  /** Whether the background is the environment map. */
  showsLight: boolean
}

/** Draws a model under a light on a canvas. */
export class Painter {
  readonly #device: GPUDevice
  readonly #context: GPUCanvasContext
  readonly #pipelines: Pipelines
  readonly #model: SceneModel
  readonly #sort = new DepthSort()
  readonly #camera: Uniform
  readonly #drawing: Uniform
  readonly #present: Uniform
  readonly #buffers: Record<'globals' | 'splats' | 'keys' | 'gaussians' | 'counts' | 'rows' | 'colours' | 'order' | 'basis', GPUBuffer>
  #blended: GPUTexture | undefined
  #normals: GPUTexture | undefined
  #sorted = ''
  #drawn = ''
  #drawnLight: SceneLight | undefined

  constructor(device: GPUDevice, context: GPUCanvasContext, pipelines: Pipelines, model: SceneModel) {
    this.#device = device
    this.#context = context
    this.#pipelines = pipelines
    this.#model = model
    this.#camera = new Uniform(device, 'Camera')
    this.#drawing = new Uniform(device, 'Drawing')
    this.#present = new Uniform(device, 'Present')
    const n = Math.max(1, model.total)
    const buffer = (label: string, size: number) =>
      device.createBuffer({ label, size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST })
    this.#buffers = {
      globals: buffer('globals', 16), splats: buffer('splats', n * SPLAT_BYTES), keys: buffer('keys', 4 * n),
      gaussians: buffer('gaussians', 4 * n), counts: buffer('counts', 16), rows: buffer('rows', n * ROW_BYTES),
      colours: buffer('colours', 16 * n), order: buffer('order', 4 * n), basis: buffer('basis', 192),
    }
  }

  /** Draws a picture. Repeats only the steps whose inputs have changed since the last picture. */
  paint(camera: Camera, light: SceneLight, finish: Finish): void {
    const output = OUTPUTS[finish.output] ?? OUTPUTS['rgb']!
    const count = Math.min(this.#model.count, light.count)
    this.#setCamera(camera)
    this.#setFinish(camera, light, finish, output.shown)
    this.#drawing.integers('what', output.blended)
    light.tables.integers('n_coefficients', this.#model.coefficients)
    for (const uniform of [this.#camera, this.#drawing, this.#present, light.tables]) uniform.upload()
    this.#order(camera, count)
    const encoder = this.#device.createCommandEncoder()
    const state = JSON.stringify([camera, finish.output, count])
    const blended = this.#target(camera)
    if (state !== this.#drawn || light !== this.#drawnLight) {
      this.#prepare(encoder, light)
      if (finish.output === 'ao') this.#blendOcclusion(encoder, blended, count)
      else this.#blend(encoder, blended, count)
      this.#drawn = state
      this.#drawnLight = light
    }
    this.#show(encoder, blended, light)
    this.#device.queue.submit([encoder.finish()])
  }

  #setCamera({ width, height, focal, rotation, translation, centre }: Camera): void {
    const { low_pass, low_pass_compensation } = this.#model.header.shading
    // Limits of x/z and y/z in the Jacobian of the projection (docs/MODEL.md section 2). The principal point is the centre of the picture.
    const limits = [width, height].flatMap((size) => [-0.65 * size / focal, 0.65 * size / focal])
    this.#camera
      .floats('focal', focal, focal).floats('centre_px', width / 2, height / 2)
      .floats('rotation', ...rotation.flatMap((row, k) => [...row, translation[k] ?? 0]))
      .floats('centre', ...centre, 0).floats('ratio_limits', ...limits)
      .integers('size', width, height).integers('tiles', Math.ceil(width / TILE), Math.ceil(height / TILE))
      .floats('low_pass', low_pass).integers('low_pass_compensation', Number(low_pass_compensation))
      .integers('n_pixels', width * height)
  }

  #setFinish({ centre }: Camera, light: SceneLight, { exposure, background, showsLight }: Finish, shown: number): void {
    const map = showsLight ? light.header.map : undefined
    // The model lies in the unit ball.
    const distance = Math.hypot(...centre)
    this.#present
      .floats('background', ...(background ? [...background, 1] : [0, 0, 0, 0]))
      .floats('gain', 2 ** exposure).integers('what', shown)
      .integers('map_size', map?.width ?? 0, map?.height ?? 0)
      .floats('depths', Math.max(0, distance - 1), distance + 1)
      .integers('visibility_form', code('VISIBILITY', this.#model.header.shading.visibility))
  }

  #order({ rotation }: Camera, count: number): void {
    const direction = rotation[2]
    const state = `${direction} ${count}`
    if (state === this.#sorted) return
    this.#sorted = state
    this.#device.queue.writeBuffer(this.#buffers.order, 0, this.#sort.sort(this.#model.means, count, direction))
  }

  #target(camera: Camera): GPUTexture {
    if (this.#blended && fits(this.#blended, camera)) return this.#blended
    this.#blended?.destroy()
    this.#drawn = ''
    this.#blended = this.#texture(camera.width, camera.height)
    return this.#blended
  }

  #texture(width: number, height: number): GPUTexture {
    const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING
    return this.#device.createTexture({ size: [width, height], format: BLENDED, usage })
  }

  /** Projects and shades every Gaussian. */
  #prepare(encoder: GPUCommandEncoder, light: SceneLight): void {
    const { globals, splats, keys, gaussians, counts, rows, colours, basis } = this.#buffers
    const { layout, params, shading, total } = this.#model
    const pass = encoder.beginComputePass()
    const run = (ready: Ready<GPUComputePipeline>, buffers: GPUBuffer[]) => {
      pass.setPipeline(ready.pipeline)
      pass.setBindGroup(0, this.#bind(ready, buffers))
      pass.dispatchWorkgroups(...grid(Math.ceil(total / GROUP)))
    }
    run(this.#pipelines.project, [this.#camera.buffer, layout.buffer, params, splats, keys, gaussians, counts])
    run(this.#pipelines.attributes, [
      this.#camera.buffer, layout.buffer, params, globals, splats, light.gathered, basis, rows,
    ])
    run(this.#pipelines.shade, [
      this.#camera.buffer, shading.buffer, light.tables.buffer, light.reflectance, light.values, light.values,
      layout.buffer, params, splats, light.gathered, basis, rows, colours,
    ])
    pass.end()
  }

  /** Blends the normals, then the visibility of each Gaussian towards the blended normals. */
  #blendOcclusion(encoder: GPUCommandEncoder, target: GPUTexture, count: number): void {
    if (!this.#normals || !fits(this.#normals, target)) {
      this.#normals?.destroy()
      this.#normals = this.#texture(target.width, target.height)
    }
    this.#blend(encoder, this.#normals, count)
    const { layout, params } = this.#model
    this.#blend(encoder, target, count, this.#pipelines.occlusion, [layout.buffer, params, this.#normals])
  }

  #blend(
    encoder: GPUCommandEncoder,
    target: GPUTexture,
    count: number,
    ready = this.#pipelines.splats,
    more: (GPUBuffer | GPUTexture)[] = [],
  ): void {
    const { splats, colours, rows, order } = this.#buffers
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: target.createView(), clearValue: [0, 0, 0, 1], loadOp: 'clear', storeOp: 'store' }],
    })
    pass.setPipeline(ready.pipeline)
    pass.setBindGroup(0, this.#bind(ready, [this.#camera.buffer, this.#drawing.buffer, splats, colours, rows, order, ...more]))
    pass.draw(4, count)
    pass.end()
  }

  #show(encoder: GPUCommandEncoder, blended: GPUTexture, light: SceneLight): void {
    const ready = this.#pipelines.present
    const view = this.#context.getCurrentTexture().createView()
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: 'clear', storeOp: 'store' }] })
    pass.setPipeline(ready.pipeline)
    pass.setBindGroup(0, this.#bind(ready, [this.#camera.buffer, this.#present.buffer, blended, light.map]))
    pass.draw(3)
    pass.end()
  }

  #bind({ layout }: Ready<unknown>, resources: (GPUBuffer | GPUTexture)[]): GPUBindGroup {
    const entries = resources.map((resource, binding) => ({
      binding,
      resource: resource instanceof GPUTexture ? resource.createView() : { buffer: resource },
    }))
    return this.#device.createBindGroup({ layout, entries })
  }
}

interface Size {
  width: number
  height: number
}

function fits(texture: GPUTexture, { width, height }: Size): boolean {
  return texture.width === width && texture.height === height
}

/** A grid for `groups` workgroups; two-dimensional above the limit of one dimension. */
function grid(groups: number): [number, number] {
  const most = 65535
  return groups <= most ? [groups, 1] : [most, Math.ceil(groups / most)]
}
