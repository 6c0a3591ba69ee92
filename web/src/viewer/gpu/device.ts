import { STORAGE_BUFFERS } from './kernels'

/** Opens a WebGPU device with the limits that the viewer needs, or returns undefined if there is none. */
export async function openDevice(): Promise<GPUDevice | undefined> {
  const adapter = await navigator.gpu?.requestAdapter()
  if (!adapter || adapter.limits.maxStorageBuffersPerShaderStage < STORAGE_BUFFERS) return undefined
  const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits
  return adapter.requestDevice({
    requiredLimits: {
      maxStorageBuffersPerShaderStage: Math.max(8, STORAGE_BUFFERS),
      maxStorageBufferBindingSize,
      maxBufferSize,
    },
  })
}
