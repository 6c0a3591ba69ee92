/** Code that sends a request: Python with the package `requests`, TypeScript with `fetch`. */

export interface SnippetRequest {
  method: string
  url: string
  headers?: Record<string, string>
  /** Text, or the fields of a form: files and text. */
  body?: unknown
}

/** The fields of a form: name and text, without text for a file. */
function formFields(body: unknown): [string, string | undefined][] | undefined {
  if (typeof body !== 'object' || body === null) return undefined
  return Object.entries(body).map(([name, value]) => [name, typeof value === 'object' ? undefined : String(value)])
}

/** The headers that the code sets itself. A library sets the content type of a form, which names its boundary. */
function headersOf(request: SnippetRequest, isForm: boolean): Record<string, string> {
  const entries = Object.entries(request.headers ?? {})
  return Object.fromEntries(entries.filter(([name]) => !(isForm && name.toLowerCase() === 'content-type')))
}

function textOf(body: unknown): string {
  return typeof body === 'string' ? body : ''
}

export function python(request: SnippetRequest): string {
  const fields = formFields(request.body)
  const lines = [
    'import requests',
    '',
    `response = requests.request(`,
    `    ${JSON.stringify(request.method.toUpperCase())},`,
    `    ${JSON.stringify(request.url)},`,
    `    headers=${JSON.stringify(headersOf(request, fields !== undefined))},`,
  ]
  if (fields) {
    const files = fields.map(([name, text]) => `${JSON.stringify(name)}: ${text === undefined ? 'open("FILE", "rb")' : `(None, ${JSON.stringify(text)})`}`)
    lines.push(`    files={${files.join(', ')}},`)
  } else if (textOf(request.body)) {
    lines.push(`    data=${JSON.stringify(textOf(request.body))},`)
  }
  lines.push(')', 'response.raise_for_status()', 'print(response.headers["content-type"], len(response.content))')
  return lines.join('\n')
}

export function typescript(request: SnippetRequest): string {
  const fields = formFields(request.body)
  const lines: string[] = []
  if (fields) {
    lines.push('const form = new FormData()')
    for (const [name, text] of fields) {
      lines.push(`form.append(${JSON.stringify(name)}, ${text === undefined ? 'file' : JSON.stringify(text)})`)
    }
  }
  lines.push(
    `const response = await fetch(${JSON.stringify(request.url)}, {`,
    `  method: ${JSON.stringify(request.method.toUpperCase())},`,
    `  headers: ${JSON.stringify(headersOf(request, fields !== undefined))},`,
  )
  if (fields) lines.push('  body: form,')
  else if (textOf(request.body)) lines.push(`  body: ${JSON.stringify(textOf(request.body))},`)
  lines.push('})', 'if (!response.ok) throw new Error((await response.json()).title)')
  return lines.join('\n')
}
