import { readFileSync } from 'node:fs'
import ts from 'typescript'

/** A module of src/ without imports at run time. */
export async function source(name) {
  const { outputText } = ts.transpileModule(readFileSync(new URL(`../src/${name}.ts`, import.meta.url), 'utf8'), {
    compilerOptions: { module: ts.ModuleKind.ESNext, target: ts.ScriptTarget.ES2022 },
  })
  return import(`data:text/javascript,${encodeURIComponent(outputText)}`)
}
