import { useEffect, useRef } from 'preact/hooks'
import type { Camera, Report } from '../api/types'

type Vector = [number, number, number]

/** A camera to draw: its position and the corners of its image plane, a short distance in front of it. */
interface Drawn {
  eye: Vector
  corners: Vector[]
  heldOut: boolean
}

function drawn(camera: Camera, size: number): Drawn | undefined {
  const rows = camera.camera.camera_to_world
  const pinhole = camera.camera.intrinsics
  if (!rows || !pinhole) return undefined
  const at = (x: number, y: number, z: number): Vector => [0, 1, 2].map((i) => {
    const [a = 0, b = 0, c = 0, d = 0] = rows[i] ?? []
    return a * x + b * y + c * z + d
  }) as Vector
  const ray = (u: number, v: number) => at(((u - pinhole.cx) / pinhole.fx) * size, ((pinhole.cy - v) / pinhole.fy) * size, -size)
  const corners = [ray(0, 0), ray(camera.width, 0), ray(camera.width, camera.height), ray(0, camera.height)]
  return { eye: at(0, 0, 0), corners, heldOut: camera.held_out }
}

/** The cameras of the photographs around the object. Pointer and arrow keys rotate the view. */
export function Rig({ cameras, report }: { cameras: Camera[]; report: Report }) {
  const canvas = useRef<HTMLCanvasElement>(null)
  const turn = useRef({ azimuth: -0.7, elevation: 0.45 })
  useEffect(() => {
    const element = canvas.current
    if (!element) return
    const paint = () => draw(element, cameras, report, turn.current)
    const stop = new AbortController()
    const { signal } = stop
    let held: PointerEvent | undefined
    const by = (azimuth: number, elevation: number) => {
      turn.current.azimuth += azimuth
      turn.current.elevation = Math.min(1.5, Math.max(-1.5, turn.current.elevation + elevation))
      paint()
    }
    element.addEventListener('pointerdown', (event) => {
      held = event
      element.setPointerCapture(event.pointerId)
    }, { signal })
    element.addEventListener('pointerup', () => (held = undefined), { signal })
    element.addEventListener('pointermove', (event) => {
      if (!held) return
      by(-(event.clientX - held.clientX) * 0.01, (event.clientY - held.clientY) * 0.01)
      held = event
    }, { signal })
    element.addEventListener('keydown', (event) => {
      const moves: Record<string, [number, number]> = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }
      const move = moves[event.key]
      if (!move) return
      event.preventDefault()
      by(...move)
    }, { signal })
    const size = new ResizeObserver(paint)
    size.observe(element)
    const scheme = new MutationObserver(paint)
    scheme.observe(document.documentElement, { attributeFilter: ['data-theme'] })
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', paint, { signal })
    return () => {
      stop.abort()
      size.disconnect()
      scheme.disconnect()
    }
  }, [cameras, report])
  const heldOut = cameras.filter((camera) => camera.held_out).length
  const label = `${cameras.length} cameras around the subject, ${heldOut} of them held out; arrow keys turn the view`
  return <canvas ref={canvas} class="rig" tabIndex={0} role="img" aria-label={label} />
}

function draw(element: HTMLCanvasElement, cameras: Camera[], report: Report, { azimuth, elevation }: { azimuth: number; elevation: number }): void {
  const context = element.getContext('2d')
  if (!context) return
  const density = window.devicePixelRatio || 1
  const { clientWidth: width, clientHeight: height } = element
  Object.assign(element, { width: width * density, height: height * density })
  context.setTransform(density, 0, 0, density, 0, 0)
  const colour = (name: string) => resolved(element, name)
  const [cx = 0, cy = 0, cz = 0] = report.centre
  const shapes = cameras.map((camera) => drawn(camera, report.radius * 0.22)).filter((shape) => shape !== undefined)
  const [sinA, cosA, sinE, cosE] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)]
  const flat = ([x, y, z]: Vector): [number, number] => {
    const [dx, dy, dz] = [x - cx, y - cy, z - cz]
    return [dx * cosA + dy * sinA, -dz * cosE - (dy * cosA - dx * sinA) * sinE]
  }
  const ring = (share: number) => Array.from({ length: 64 }, (_, i): Vector => [cx + report.radius * share * Math.cos(i * 0.0982), cy + report.radius * share * Math.sin(i * 0.0982), cz])
  // Scale the drawing to the canvas, with a margin.
  const extent = [...ring(1), ...shapes.flatMap(({ eye, corners }) => [eye, ...corners])].map(flat)
  const [left, right] = [Math.min(...extent.map(([x]) => x)), Math.max(...extent.map(([x]) => x))]
  const [top, bottom] = [Math.min(...extent.map(([, y]) => y)), Math.max(...extent.map(([, y]) => y))]
  const scale = 0.9 * Math.min(width / (right - left), height / (bottom - top))
  const project = (point: Vector): [number, number] => {
    const [x, y] = flat(point)
    return [width / 2 + (x - (left + right) / 2) * scale, height / 2 + (y - (top + bottom) / 2) * scale]
  }
  const stroke = (points: Vector[], close: boolean) => {
    context.beginPath()
    points.forEach((point, i) => (i ? context.lineTo(...project(point)) : context.moveTo(...project(point))))
    if (close) context.closePath()
    context.stroke()
  }
  context.strokeStyle = colour('--muted')
  context.globalAlpha = 0.45
  for (const share of [0.5, 1]) stroke(ring(share), true)
  context.globalAlpha = 1
  context.fillStyle = colour('--muted')
  const [sx, sy] = project([cx, cy, cz])
  context.beginPath()
  context.arc(sx, sy, 3, 0, 7)
  context.fill()
  for (const { eye, corners, heldOut } of shapes) {
    context.strokeStyle = colour(heldOut ? '--cool' : '--accent')
    context.lineWidth = 1.1
    stroke(corners, true)
    for (const corner of corners) stroke([eye, corner], false)
  }
}

/** The value of a custom property in the current colour scheme. */
function resolved(element: HTMLElement, name: string): string {
  const before = element.style.color
  element.style.color = `var(${name})`
  const { color } = getComputedStyle(element)
  element.style.color = before
  return color
}
