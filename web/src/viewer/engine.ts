import type { Look } from './frames'
import type { OrbitView } from './orbit'

/** Which engine draws. */
export type ViewerMode = 'webgpu' | 'server'

/** Draws a model where the viewer shows it. */
export interface Engine {
  readonly mode: ViewerMode
  /** What shows the picture. */
  readonly node: HTMLElement
  /** The view to begin with. */
  readonly begin: Partial<OrbitView>
  /** Draws soon; `moving`: more follows, so that time counts more than detail. */
  draw(look: Look, view: OrbitView, moving: boolean): void
  /** The whole picture as a PNG, once everything that it needs has come. */
  snapshot(look: Look, view: OrbitView): Promise<Blob>
  close(): void
}

/** Told by an engine. */
export interface EngineListener {
  /** Size of the place of the picture, CSS pixels. */
  size(): [number, number]
  /** The first whole picture is shown. */
  ready(): void
  /** A picture is shown and another could follow. */
  shown(): void
  /** Something that was asked for could not be drawn. */
  failed(error: unknown): void
  /** The engine cannot go on. */
  lost(): void
}
