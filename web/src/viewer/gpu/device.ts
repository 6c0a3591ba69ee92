import { STORAGE_BUFFERS } from './kernels'

/** A device that can draw, or nothing where this browser or machine has none. */
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
