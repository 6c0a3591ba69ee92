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

export function moment(rfc3339: string | null | undefined): string {
  if (!rfc3339) return '–'
  return new Date(rfc3339).toLocaleString('en', { dateStyle: 'medium', timeStyle: 'short' })
}

/** The label of a resource: its name, or its kind and the last six characters of its identifier. */
export function called(thing: { id: string; name?: string | null }, kind: string): string {
  return thing.name ?? `${kind} ${thing.id.slice(-6)}`
}
