import type { Look } from './frames'
import type { OrbitView } from './orbit'
import type { PhotographedViews } from './photographed'

/** The engine that draws. */
export type ViewerMode = 'webgpu' | 'server'

/** Draws a model in the viewer. */
export interface Engine {
  readonly mode: ViewerMode
  /** The element that shows the picture. */
  readonly node: HTMLElement
  /** The initial view. */
  readonly begin: Partial<OrbitView>
  /** The photographed directions, if the model records them. */
  readonly photographed: PhotographedViews | undefined
  /** Schedules a picture. `moving`: more pictures follow, so the engine may reduce detail to save time. */
  draw(look: Look, view: OrbitView, moving: boolean): void
  /** The point of the model in front at a position of the picture, CSS pixels from its upper left corner; undefined if the engine cannot tell. */
  pick(view: OrbitView, x: number, y: number): [number, number, number] | undefined
  /** The complete picture as a PNG; waits until all its data has arrived. */
  snapshot(look: Look, view: OrbitView): Promise<Blob>
  close(): void
}

/** Receives the events of an engine. */
export interface EngineListener {
  /** Size of the picture's area, CSS pixels. */
  size(): [number, number]
  /** The first complete picture is shown. */
  ready(): void
  /** Bytes of the model that have arrived, and their total if the server states it. */
  loaded(bytes: number, total: number | undefined): void
  /** Whether a chosen light is on its way while the picture shows the previous one. */
  waiting(isWaiting: boolean): void
  /** A picture is shown, and the engine can draw another. */
  shown(): void
  /** The engine could not draw a requested picture. */
  failed(error: unknown): void
  /** The engine cannot continue, e.g. because it lost its device. */
  lost(): void
}
