/** A value as a function of the training step. */
export interface Curve {
  points: { x: number; y: number }[]
}

const [WIDTH, HEIGHT] = [460, 190]
const [LEFT, RIGHT, TOP, BOTTOM] = [44, 12, 10, 26]
/** Maximum number of drawn points; a screen cannot show more. */
const MOST = 600

/** Round tick values that divide a range into three to six parts. */
export function ticks(low: number, high: number): number[] {
  const span = high - low || 1
  const rough = span / 4
  const power = 10 ** Math.floor(Math.log10(rough))
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough) ?? rough
  const found: number[] = []
  for (let at = Math.ceil(low / step) * step; at <= high + step * 1e-6; at += step) found.push(Number(at.toPrecision(6)))
  return found
}

function thinned<T>(points: T[]): T[] {
  const every = Math.max(1, Math.ceil(points.length / MOST))
  return points.filter((_, i) => i % every === 0 || i === points.length - 1)
}

/** Averages each value with its neighbours, because each step uses another photograph and their errors differ. */
function smooth(points: Curve['points']): Curve['points'] {
  const reach = Math.floor(points.length / 24)
  return points.map(({ x }, i) => {
    const near = points.slice(Math.max(0, i - reach), i + reach + 1)
    return { x, y: near.reduce((sum, { y }) => sum + y, 0) / near.length }
  })
}

/** A small plot of one or two curves. `log` makes the value axis logarithmic. */
export function Plot({ title, unit, curves, end, log }: { title: string; unit: string; curves: Curve[]; end: number; log?: boolean }) {
  const shape = (y: number) => (log ? Math.log10(Math.max(y, 1e-9)) : y)
  const all = curves.flatMap((curve) => curve.points.map(({ y }) => shape(y)))
  const last = curves[0]?.points.at(-1)
  if (!last) return <p class="muted small">{title}: nothing to plot yet</p>
  const [lowest, highest] = [Math.min(...all), Math.max(...all)]
  const margin = (highest - lowest) * 0.08 || 0.5
  const [low, high] = [lowest - margin, highest + margin]
  const x = (step: number) => LEFT + (step / Math.max(end, 1)) * (WIDTH - LEFT - RIGHT)
  const y = (value: number) => TOP + (1 - (shape(value) - low) / (high - low)) * (HEIGHT - TOP - BOTTOM)
  const marks = ticks(low, high).map((mark) => (log ? 10 ** mark : mark))
  const path = (points: Curve['points']) => thinned(points).map((point, i) => `${i ? 'L' : 'M'}${x(point.x).toFixed(1)} ${y(point.y).toFixed(1)}`).join('')
  const label = `${title}: ${last.y.toPrecision(4)} ${unit} at step ${last.x} of ${end}`
  return (
    <svg class="plot" viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={label}>
      {marks.map((mark) => (
        <g key={mark}>
          <line class="grid" x1={LEFT} x2={WIDTH - RIGHT} y1={y(mark)} y2={y(mark)} />
          <text x={LEFT - 6} y={y(mark) + 4} text-anchor="end">{Number(mark.toPrecision(3))}</text>
        </g>
      ))}
      {ticks(0, end).map((step) => <text key={step} x={x(step)} y={HEIGHT - 6} text-anchor="middle">{step}</text>)}
      {curves.length === 1 ? curves.map(({ points }, i) => <path key={i} class="raw" d={path(points)} />) : null}
      {curves.map(({ points }, i) => <path key={i} class={i ? 'line second' : 'line'} d={path(smooth(points))} />)}
      {curves.length === 1 ? <circle class="dot" cx={x(last.x)} cy={y(last.y)} r="3.5" /> : null}
    </svg>
  )
}
