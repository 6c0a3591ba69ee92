import { useRef } from 'preact/hooks'

/** Degrees per arrow key. */
const STEP = 5

/** Turns the light around the model: drag the sun, or use the arrow keys. The model is in the middle, seen from above. */
export function LightDial({ value, onChange }: { value: number; onChange: (degrees: number) => void }) {
  const dial = useRef<HTMLDivElement>(null)
  const wrapped = (degrees: number) => ((((degrees + 180) % 360) + 360) % 360) - 180
  const turn = (event: PointerEvent) => {
    if (!dial.current?.hasPointerCapture(event.pointerId)) return
    const box = dial.current.getBoundingClientRect()
    const [x, y] = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2]
    // 0 is at the bottom, as seen from the camera; counter-clockwise seen from above.
    onChange(wrapped(STEP * Math.round((Math.atan2(x, y) * 180) / Math.PI / STEP)))
  }
  const key = (event: KeyboardEvent) => {
    const by = { ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP }[event.key]
    if (by === undefined) return
    event.preventDefault()
    onChange(wrapped(value + by))
  }
  return (
    <div
      ref={dial}
      class="dial"
      role="slider"
      tabIndex={0}
      title="Turn the light: drag the sun"
      aria-label="Direction of the light"
      aria-valuemin={-180}
      aria-valuemax={180}
      aria-valuenow={value}
      aria-valuetext={`${value} degrees`}
      onPointerDown={(event) => {
        event.preventDefault()
        event.currentTarget.focus()
        event.currentTarget.setPointerCapture(event.pointerId)
        turn(event)
      }}
      onPointerMove={turn}
      onKeyDown={key}
    >
      <span class="sun" style={{ '--turn': `${-value}deg` }} />
      <small>Light</small>
    </div>
  )
}
