// Typesets equations with KaTeX. node equations.mjs KATEX <EQUATIONS >HTML: KATEX is the file katex.mjs. The input is a JSON list of [LATEX, IS_DISPLAY],
// the output a JSON list of HTML. It fails on LaTeX that KaTeX does not know.
import { readFileSync } from 'node:fs';
import { resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const { default: katex } = await import(pathToFileURL(resolve(process.argv[2])));
const typeset = ([latex, displayMode]) => {
    try {
        return katex.renderToString(latex, { displayMode, strict: 'error', throwOnError: true });
    } catch (error) {
        console.error(`${latex}: ${error.message}`);
        process.exit(1);
    }
};
process.stdout.write(JSON.stringify(JSON.parse(readFileSync(0, 'utf8')).map(typeset)));
