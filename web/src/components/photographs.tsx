import { useState } from 'preact/hooks'
import type { Photograph } from '../api/types'
import { Picture } from './common'

/** Photographs that are shown until the user asks for all. */
const SHOWN = 24
/** Width of a thumbnail, pixels. */
const WIDTH = 320

/** The photographs of a capture with their validation warnings; photographs with warnings come first. Warnings that all photographs share are left out, because the report shows them. */
export function PhotographList({ of: photographs }: { of: Photograph[] }) {
  const [all, setAll] = useState(false)
  const own = ({ warnings }: Photograph) => warnings.filter((warning) => !photographs.every((other) => other.warnings.includes(warning)))
  const rows = photographs.map((photograph) => ({ photograph, warnings: own(photograph) }))
  const sorted = [...rows.filter(({ warnings }) => warnings.length), ...rows.filter(({ warnings }) => !warnings.length)]
  const shown = all ? sorted : sorted.slice(0, SHOWN)
  return (
    <>
      <ul class="taken" aria-label={`${photographs.length} photographs`}>
        {shown.map(({ photograph, warnings }) => (
          <li key={photograph.name}>
            <figure>
              <div class="stage"><Picture path={`${photograph.href}?width=${WIDTH}`} alt={`Photograph ${photograph.name}`} /></div>
              <figcaption>
                <span class="name">{photograph.name}</span>{photograph.held_out ? <span class="muted"> held out</span> : null}
                {warnings.map((warning) => <p key={warning} class="notice small">{warning}</p>)}
              </figcaption>
            </figure>
          </li>
        ))}
      </ul>
      {shown.length < sorted.length ? <button type="button" onClick={() => setAll(true)}>Show all {sorted.length}</button> : null}
    </>
  )
}
