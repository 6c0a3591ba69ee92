import type { ComponentChildren } from 'preact'
import { useRef, useState } from 'preact/hooks'
import type { Photographs } from '../api/types'
import { useLoaded } from '../hooks'
import { Failure, Picture } from './common'

/** Side of a patch that a click chooses, as a share of the longest side of the photograph, and its least side in pixels. */
const SHARE = 0.03
const LEAST = 4
/** Distance in pixels of the screen from which a movement of the pointer is a drag. */
const DRAG = 4

/** A rectangle of a photograph, in its pixels. */
export interface Patch {
  photo: string
  x: number
  y: number
  width: number
  height: number
}

interface PatchPickerProps {
  /** Prefix of the identifiers of its fields. */
  id: string
  capture: string
  legend: string
  /** Whether held-out photographs are offered. */
  heldOut: boolean
  value: Patch | undefined
  onChange: (patch: Patch | undefined) => void
  /** More fields. */
  children: ComponentChildren
}

type Point = [number, number]

/** Chooses a rectangle of a photograph of a capture: by a click, by a drag, or by numbers. */
export function PatchPicker({ id, capture, legend, heldOut, value, onChange, children }: PatchPickerProps) {
  const taken = useLoaded<Photographs>(`v1/captures/${encodeURIComponent(capture)}/photographs`)
  const [name, setName] = useState<string>()
  const begin = useRef<{ at: Point; screen: Point } | undefined>(undefined)
  const photographs = (taken.data?.photographs ?? []).filter(({ held_out }) => heldOut || !held_out)
  const photograph = photographs.find((one) => one.name === name) ?? photographs[0]
  if (!photograph) return <Failure error={taken.error} retry={taken.reload} />
  const { width, height, href } = photograph
  const set = (x: number, y: number, wide: number, high: number) => {
    const size = (side: number, most: number) => Math.min(Math.max(1, Math.round(side)), most)
    const [w, h] = [size(wide, width), size(high, height)]
    const inside = (at: number, most: number) => Math.min(Math.max(0, Math.round(at)), most)
    onChange({ photo: photograph.name, x: inside(x, width - w), y: inside(y, height - h), width: w, height: h })
  }
  const at = (event: PointerEvent): Point => {
    const box = (event.currentTarget as HTMLElement).getBoundingClientRect()
    const inside = (share: number) => Math.min(1, Math.max(0, share))
    return [inside((event.clientX - box.left) / box.width) * width, inside((event.clientY - box.top) / box.height) * height]
  }
  const isDrag = (event: PointerEvent) => begin.current && Math.hypot(event.clientX - begin.current.screen[0], event.clientY - begin.current.screen[1]) >= DRAG
  const down = (event: PointerEvent) => {
    if (event.button !== 0) return
    begin.current = { at: at(event), screen: [event.clientX, event.clientY] }
    ;(event.currentTarget as HTMLElement).setPointerCapture(event.pointerId)
  }
  const move = (event: PointerEvent) => {
    if (!begin.current || !isDrag(event)) return
    const [[x, y], [right, bottom]] = [begin.current.at, at(event)]
    set(Math.min(x, right), Math.min(y, bottom), Math.abs(right - x), Math.abs(bottom - y))
  }
  const up = (event: PointerEvent) => {
    if (begin.current && !isDrag(event)) {
      const side = Math.max(LEAST, Math.round(SHARE * Math.max(width, height)))
      const [x, y] = begin.current.at
      set(x - side / 2, y - side / 2, side, side)
    }
    begin.current = undefined
  }
  const percent = (part: number, whole: number) => `${(100 * part) / whole}%`
  const now = { x: value?.x ?? 0, y: value?.y ?? 0, width: value?.width ?? LEAST, height: value?.height ?? LEAST }
  const change = (some: Partial<typeof now>) => {
    const { x, y, width, height } = { ...now, ...some }
    set(x, y, width, height)
  }
  return (
    <fieldset class="stack">
      <legend>{legend}</legend>
      <div class="fields">
        <div>
          <label for={`${id}-photo`}>Photograph with the surface</label>
          <select id={`${id}-photo`} value={photograph.name} onChange={(event) => {
            setName(event.currentTarget.value)
            onChange(undefined)
          }}>{photographs.map((one) => <option key={one.name} value={one.name}>{one.name}</option>)}</select>
        </div>
        {children}
      </div>
      <div class="patch" onPointerDown={down} onPointerMove={move} onPointerUp={up} onPointerCancel={() => (begin.current = undefined)} onDragStart={(event) => event.preventDefault()}>
        <Picture path={`${href}?width=${Math.min(width, 800)}`} alt={`Photograph ${photograph.name}`} />
        {value ? <span style={{ left: percent(value.x, width), top: percent(value.y, height), width: percent(value.width, width), height: percent(value.height, height) }} /> : null}
      </div>
      <details>
        <summary>Details: the patch in pixels</summary>
        <div class="fields">
          <Pixels id={`${id}-x`} label="Left" value={now.x} onInput={(x) => change({ x })} />
          <Pixels id={`${id}-y`} label="Top" value={now.y} onInput={(y) => change({ y })} />
          <Pixels id={`${id}-width`} label="Width" value={now.width} onInput={(width) => change({ width })} />
          <Pixels id={`${id}-height`} label="Height" value={now.height} onInput={(height) => change({ height })} />
        </div>
      </details>
    </fieldset>
  )
}

function Pixels({ id, label, value, onInput }: { id: string; label: string; value: number; onInput: (value: number) => void }) {
  return <div><label for={id}>{label}</label><input id={id} type="number" min={0} step={1} value={value} onChange={(event) => onInput(Number(event.currentTarget.value))} /></div>
}
