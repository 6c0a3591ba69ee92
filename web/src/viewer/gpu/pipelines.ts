import { bindings, module, type KernelName } from './kernels'

/** Format of the blended picture: linear light times coverage in rgb, the remaining transmittance in alpha. */
export const BLENDED: GPUTextureFormat = 'rgba16float'

/** Front-to-back blending: the alpha of the target is the transmittance so far. */
const FRONT_TO_BACK: GPUBlendState = {
  color: { srcFactor: 'dst-alpha', dstFactor: 'one', operation: 'add' },
  alpha: { srcFactor: 'zero', dstFactor: 'one-minus-src-alpha', operation: 'add' },
}

/** A compiled pipeline and its bind group layout. */
export interface Ready<Pipeline> {
  pipeline: Pipeline
  layout: GPUBindGroupLayout
}

/** All pipelines, for models with a given number of visibility coefficients. */
export interface Pipelines {
  project: Ready<GPUComputePipeline>
  attributes: Ready<GPUComputePipeline>
  shade: Ready<GPUComputePipeline>
  splats: Ready<GPURenderPipeline>
  occlusion: Ready<GPURenderPipeline>
  present: Ready<GPURenderPipeline>
}

export async function makePipelines(device: GPUDevice, canvas: GPUTextureFormat, coefficients: number): Promise<Pipelines> {
  const compute = async (name: KernelName): Promise<Ready<GPUComputePipeline>> => {
    const layout = bindings(device, name, GPUShaderStage.COMPUTE)
    const pipeline = await device.createComputePipelineAsync({
      label: name,
      layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }),
      compute: { module: module(device, name, coefficients), entryPoint: 'main' },
    })
    return { pipeline, layout }
  }
  const draw = async (name: KernelName, target: GPUColorTargetState, topology: GPUPrimitiveTopology): Promise<Ready<GPURenderPipeline>> => {
    const layout = bindings(device, name, GPUShaderStage.VERTEX | GPUShaderStage.FRAGMENT)
    const code = module(device, name, coefficients)
    const pipeline = await device.createRenderPipelineAsync({
      label: name,
      layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }),
      vertex: { module: code, entryPoint: 'corner' },
      fragment: { module: code, entryPoint: 'fragment', targets: [target] },
      primitive: { topology },
    })
    return { pipeline, layout }
  }
  const blend = (name: KernelName) => draw(name, { format: BLENDED, blend: FRONT_TO_BACK }, 'triangle-strip')
  const [project, attributes, shade, splats, occlusion, present] = await Promise.all([
    compute('PROJECT'), compute('ATTRIBUTES'), compute('SHADE'), blend('SPLATS'), blend('OCCLUSION'),
    draw('PRESENT', { format: canvas }, 'triangle-list'),
  ])
  return { project, attributes, shade, splats, occlusion, present }
}
