import type { Job } from './api/types'

/** Formats numbers and times for the user. */

export function bytes(count: number): string {
  const units = ['B', 'kB', 'MB', 'GB', 'TB']
  let [value, unit] = [count, 0]
  while (value >= 1000 && unit < units.length - 1) [value, unit] = [value / 1000, unit + 1]
  return `${value >= 100 || unit === 0 ? Math.round(value) : value.toFixed(1)} ${units[unit] ?? ''}`
}

export function count(value: number | null | undefined): string {
  return value == null ? '–' : value.toLocaleString('en')
}

export function decibels(value: number | null | undefined): string {
  return value == null ? '–' : `${value.toFixed(2)} dB`
}

export function share(value: number | null | undefined): string {
  return value == null ? '–' : value.toFixed(4)
}

export function duration(seconds: number | null | undefined): string {
  if (seconds == null || !Number.isFinite(seconds)) return '–'
  if (seconds < 60) return `${Math.round(seconds)} s`
  const minutes = Math.floor(seconds / 60)
  if (minutes < 60) return `${minutes} min ${Math.round(seconds % 60)} s`
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`
}

/** A duration in words, rounded: `2 minutes`. */
export function spoken(seconds: number): string {
  const units = [[3600, 'hour'], [60, 'minute'], [1, 'second']] as const
  const [size, unit] = units.find(([size]) => seconds >= 0.98 * size) ?? units[2]
  const value = size === 3600 ? Math.round((2 * seconds) / size) / 2 : Math.max(1, Math.round(seconds / size))
  return `${value} ${unit}${value === 1 ? '' : 's'}`
}

/** What a training was asked to do: its time, or its preset. */
export function planOf({ preset, overrides }: Job): string {
  return overrides.time_budget_s ? spoken(overrides.time_budget_s) : preset
}

/** The agreement with photographs in words, at the size at which they were compared. The bounds are conventions. */
export function quality(psnr: number | null | undefined, side?: number): string {
  if (psnr == null) return '–'
  const word = psnr >= 34 ? 'very good' : psnr >= 30 ? 'good' : psnr >= 25 ? 'fair' : 'rough'
  return side ? `${word} at ${side} pixels` : word
}

export function moment(rfc3339: string | null | undefined): string {
  if (!rfc3339) return '–'
  return new Date(rfc3339).toLocaleString('en', { dateStyle: 'medium', timeStyle: 'short' })
}

/** The label of a resource: its name, or its kind and the last six characters of its identifier. */
export function called(thing: { id: string; name?: string | null }, kind: string): string {
  return thing.name ?? `${kind} ${thing.id.slice(-6)}`
}
