import { DELIGHT_SIDE, type DelightFormat } from '../look'
import { NumberField } from './number-field'

interface DelightFieldsProps {
  format: DelightFormat
  /** Longest side of the layers, pixels. Undefined: that of the photographs. */
  side: number | undefined
  onFormat: (format: DelightFormat) => void
  onSide: (side: number | undefined) => void
}

/** The settings of an export of photographs without their light. */
export function DelightFields({ format, side, onFormat, onSide }: DelightFieldsProps) {
  return (
    <>
      <div class="fields">
        <div>
          <label for="take-format">Format</label>
          <select id="take-format" value={format} onChange={(event) => onFormat(event.currentTarget.value as DelightFormat)}>
            <option value="exr">EXR</option>
            <option value="png">PNG</option>
          </select>
        </div>
        <NumberField id="take-longest" label="Longest side, px" value={side} step={1} least={DELIGHT_SIDE.least} most={DELIGHT_SIDE.most} empty="unchanged" onInput={onSide} />
      </div>
      <p class="small">The file has the albedo, the shading, the shadow and the specular reflection of each photograph. {format === 'exr' ? 'An EXR has all layers of a photograph, in linear half floats.' : 'The PNG files have 8 bits. Shading and shadow above 1 are clipped.'} Without a longest side the layers have the size of the photographs.</p>
    </>
  )
}
