import type { Lamp } from '../api/types'
import { coloured, KELVIN, reshaped, SHAPES, short, type Point, type Staging } from '../lamps'
import { Choices, Slider } from './common'
import { NumberField } from './number-field'

/** Bounds of the slider for the intensity, stops from the reference. */
const STOPS = { least: -10, most: 6 } as const
/** The initial values of the other way to state a colour. */
const KELVIN_START = 3200
const COLOUR_START = '#ffb46b'
/** Colour of a new ground. */
const FLOOR = '#b8b2a8'

interface LampFieldsProps {
  lamp: Lamp
  number: number
  /** The middle of the view, for lamps that face a point for the first time. */
  centre: Point
  /** Distance of the camera, capture units: the scale of all lengths. */
  scale: number
  onChange: (lamp: Lamp) => void
}

/** The power of ten for the steps of lengths in a scene of this scale. */
export function stepOf(scale: number): number {
  return Number((10 ** Math.floor(Math.log10(scale / 20))).toPrecision(1))
}

/** The values of one lamp. */
export function LampFields({ lamp, number, centre, scale, onChange }: LampFieldsProps) {
  const change = (some: Partial<Lamp>) => onChange({ ...lamp, ...some })
  const step = stepOf(scale)
  return (
    <fieldset class="stack tight">
      <legend>Lamp {number}</legend>
      <Choices legend="Shape" name="lamp-shape" pills value={lamp.shape} of={SHAPES.map(([value, label]) => ({ value, label }))} onChange={(shape) => onChange(reshaped(lamp, shape as Lamp['shape'], centre))} />
      <Strength value={lamp.intensity ?? 0} reference={scale * scale} onInput={(intensity) => change({ intensity })} />
      <Colour lamp={lamp} onChange={onChange} />
      {lamp.shape === 'spot' ? <Slider label="Cone" value={lamp.cone_deg ?? 45} min={5} max={170} step={1} unit="°" onInput={(cone_deg) => change({ cone_deg })} /> : null}
      <Place id="lamp-position" legend="Position" value={lamp.position} step={step} onInput={(position) => change({ position })} />
      {lamp.target ? <Place id="lamp-target" legend="Target" value={lamp.target} step={step} onInput={(target) => change({ target })} /> : null}
      <Extent lamp={lamp} step={step / 10} onChange={change} />
      <p class="hint">Lengths are in units of the capture; +Z is up. The intensity is the irradiance at a distance of 1 unit. <em>Exposure</em> does not change lamps.</p>
    </fieldset>
  )
}

/** The intensity: a slider in stops, and the number. */
function Strength({ value, reference, onInput }: { value: number; reference: number; onInput: (intensity: number) => void }) {
  const stops = Math.min(STOPS.most, Math.max(STOPS.least, Math.log2(value / reference)))
  return (
    <div class="exact">
      <label for="lamp-intensity">Intensity</label>
      <input id="lamp-intensity" type="range" min={STOPS.least} max={STOPS.most} step={0.25} value={stops} aria-valuetext={String(short(value))} onInput={(event) => onInput(Number((reference * 2 ** Number(event.currentTarget.value)).toPrecision(3)))} />
      <NumberField id="lamp-intensity-number" label="Intensity as a number" value={short(value)} step={stepOf(2 * Math.max(value, 1e-6))} least={0} onInput={(intensity) => onInput(intensity ?? 0)} />
    </div>
  )
}

/** The colour: a colour temperature, or a colour in sRGB. */
function Colour({ lamp, onChange }: { lamp: Lamp; onChange: (lamp: Lamp) => void }) {
  const { colour } = lamp
  const ways = [{ value: 'kelvin', label: 'temperature' }, { value: 'colour', label: 'a colour' }]
  const choose = (way: string) => onChange(coloured(lamp, way === 'kelvin' ? { kelvin: KELVIN_START } : { colour: COLOUR_START }))
  return (
    <>
      <div class="row">
        <Choices legend="Colour of the lamp" name="lamp-colour" pills value={colour ? 'colour' : 'kelvin'} of={ways} onChange={choose} />
        {colour ? <input type="color" aria-label="sRGB colour of the lamp" value={colour} onInput={(event) => onChange(coloured(lamp, { colour: event.currentTarget.value }))} /> : null}
      </div>
      {colour ? null : <Slider label="Colour temperature" value={lamp.kelvin ?? KELVIN_START} min={KELVIN.least} max={12_000} step={100} unit=" K" onInput={(kelvin) => onChange(coloured(lamp, { kelvin }))} />}
    </>
  )
}

/** The three coordinates of a point. */
function Place({ id, legend, value, step, onInput }: { id: string; legend: string; value: number[]; step: number; onInput: (value: number[]) => void }) {
  return (
    <fieldset>
      <legend>{legend}</legend>
      <div class="coordinates">
        {['x', 'y', 'z'].map((axis, k) => (
          <NumberField key={axis} id={`${id}-${axis}`} label={axis} value={value[k]} step={step} onInput={(number) => onInput(value.map((before, i) => (i === k ? number ?? before : before)))} />
        ))}
      </div>
    </fieldset>
  )
}

/** The size of a lamp: a radius, or the sides of a rectangle. */
function Extent({ lamp, step, onChange }: { lamp: Lamp; step: number; onChange: (some: Partial<Lamp>) => void }) {
  if (lamp.shape !== 'rectangle') return <NumberField id="lamp-radius" label="Radius (0: sharp shadows)" value={lamp.radius ?? 0} step={step} least={0} onInput={(radius) => onChange({ radius: radius ?? 0 })} />
  const [width = step, height = step] = lamp.size ?? []
  return (
    <div class="coordinates two">
      <NumberField id="lamp-width" label="Width" value={width} step={step} least={step / 100} onInput={(value) => onChange({ size: [value ?? width, height] })} />
      <NumberField id="lamp-height" label="Height" value={height} step={step} least={step / 100} onInput={(value) => onChange({ size: [width, value ?? height] })} />
    </div>
  )
}

/** The ground below the model. */
export function GroundFields({ staging: { floor, height, lamps }, scale, onChange }: { staging: Staging; scale: number; onChange: (some: Partial<Staging>) => void }) {
  return (
    <fieldset class="stack tight">
      <legend>Ground</legend>
      <label class="check"><input type="checkbox" checked={floor !== undefined} onChange={(event) => onChange({ floor: event.currentTarget.checked ? FLOOR : undefined })} />On the ground</label>
      {floor ? (
        <>
          <div class="coordinates two">
            <div>
              <label for="ground-colour">Colour of the ground</label>
              <input id="ground-colour" type="color" value={floor} onInput={(event) => onChange({ floor: event.currentTarget.value })} />
            </div>
            <NumberField id="ground-height" label="Height of the ground" value={height} step={stepOf(scale) / 10} empty="lowest point" onInput={(height) => onChange({ height })} />
          </div>
          <p class="hint">The model casts its shadow on the ground{lamps.length > 0 ? ', and lamps light it' : ''}. If the model contains its own floor, choose a height slightly above it.</p>
        </>
      ) : null}
    </fieldset>
  )
}
