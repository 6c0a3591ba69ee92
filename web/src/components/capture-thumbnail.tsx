import type { Photographs } from '../api/types'
import { useLoaded, useSeen } from '../hooks'
import { Picture } from './common'

/** The first photograph of a capture, small. It is loaded when it comes into view. */
export function CaptureThumbnail({ capture }: { capture: string }) {
  const [element, isSeen] = useSeen<HTMLDivElement>()
  const taken = useLoaded<Photographs>(isSeen ? `v1/captures/${encodeURIComponent(capture)}/photographs` : undefined)
  const first = taken.data?.photographs[0]
  return <div class="stage" ref={element}><Picture path={first ? `${first.href}?width=320` : undefined} alt="" /></div>
}
