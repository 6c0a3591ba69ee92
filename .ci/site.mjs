// Opens the documentation site in Chromium: the version selector, the tabs of code blocks, equations, the width of every page on a telephone, and the
// origin of all that pages load. node .ci/site.mjs BROWSER SERVER FOLDER VERSION...
import assert from 'node:assert';
import { readdir, rename } from 'node:fs/promises';
import { join, relative } from 'node:path';
import { openBrowser, openPage } from './browser.mjs';

const [program, server, folder, ...versions] = process.argv.slice(2);
/** Width of a page on a telephone, pixels. */
const NARROW = 390;

/** Texts of the entries of the version selector, once there is one; an empty list after `wait` milliseconds without one. */
async function selector(wait) {
    for (let waited = 0; waited < wait; waited += 100) {
        const found = [...document.querySelectorAll('.md-version__link')].map((link) => link.textContent.trim());
        if (found.length) return [document.querySelector('.md-version__current').firstChild.textContent.trim(), ...found];
        await new Promise((resolve) => setTimeout(resolve, 100));
    }
    return [];
}

/** URLs of all that the page has loaded. */
const loaded = () => performance.getEntries().map((entry) => entry.name).filter((name) => name.includes('://'));

/**
 * Shows a page in a frame of `width` pixels. Returns by how many pixels it is too wide, what it has loaded, how many equations scroll in their boxes, and
 * by how many pixels the page is too wide if they do not.
 */
async function inFrame(url, width) {
    const frame = document.createElement('iframe');
    frame.style.cssText = `width: ${width}px; height: 800px; border: 0`;
    const shown = new Promise((resolve) => frame.addEventListener('load', resolve, { once: true }));
    frame.src = url;
    document.body.append(frame);
    await shown;
    const { contentWindow, contentDocument } = frame;
    await new Promise((resolve) => setTimeout(resolve, 50));
    const over = contentDocument.documentElement.scrollWidth - width;
    const from = contentWindow.performance.getEntries().map((entry) => entry.name).filter((name) => name.includes('://'));
    const boxes = [...contentDocument.querySelectorAll('div.arithmatex')];
    const scrolls = (box) => box.scrollWidth > box.clientWidth && contentWindow.getComputedStyle(box).overflowX === 'auto';
    const scrolling = boxes.filter(scrolls).length;
    boxes.forEach((box) => (box.style.overflow = 'visible'));
    const unboxed = contentDocument.documentElement.scrollWidth - width;
    frame.remove();
    return { over, from, scrolling, unboxed };
}

/** Whether a click on the tab of a language shows that language in every group of the page. */
async function tabs(language) {
    const groups = [...document.querySelectorAll('.tabbed-set')];
    const label = [...groups[0].querySelectorAll('.tabbed-labels label')].find((one) => one.textContent.trim() === language);
    label.click();
    await new Promise((resolve) => setTimeout(resolve, 500));
    return groups.map((group) => {
        const at = [...group.querySelectorAll('.tabbed-labels label')].findIndex((one) => one.textContent.trim() === language);
        return [...group.querySelectorAll('.tabbed-block')].map((block) => getComputedStyle(block).display !== 'none').indexOf(true) === at;
    });
}

/** The equations of the page: how many there are, how many failed, whether the fonts of KaTeX are loaded, and whether their MathML is hidden. */
async function equations() {
    await document.fonts.ready;
    const [all, blocks, failed] = ['.katex', '.katex-display', '.katex-error'].map((name) => document.querySelectorAll(name).length);
    const fonts = [...document.fonts].filter(({ family, status }) => family.includes('KaTeX') && status === 'loaded').length;
    const marked = document.querySelectorAll('.arithmatex').length;
    const isHidden = () => getComputedStyle(document.querySelector('.katex-mathml')).position === 'absolute';
    const hidden = all > 0 && isHidden();
    document.querySelectorAll('link[href*="katex"]').forEach((link) => link.remove());
    return { all, blocks, failed, fonts, marked, hidden, hiddenWithoutStyle: all > 0 && isHidden() };
}

const pages = async (version) => {
    const files = await readdir(join(folder, version), { recursive: true });
    return files.filter((file) => file.endsWith('index.html')).map((file) => `/${version}/${relative('.', file).replace('index.html', '')}`);
};
const isElsewhere = (url) => !url.startsWith(`${server}/`) && !url.startsWith('data:') && !url.startsWith('blob:') && !url.startsWith('about:');

const browser = await openBrowser(program, []);
try {
    for (const version of versions) {
        const page = await openPage(browser, `${server}/${version}/`);
        assert.deepEqual(await page.run(selector, 10000), [version, ...versions], 'the version selector');
        assert.deepEqual((await page.run(loaded)).filter(isElsewhere), []);
    }
    const first = await openPage(browser, `${server}/latest/docs/guide/first-calls/`);
    assert.equal((await first.run(selector, 10000))[0], versions[0], 'latest is the newest version');
    const shown = await first.run(tabs, 'TypeScript');
    assert(shown.length >= 8 && shown.every(Boolean), `TypeScript in every group of tabs: ${shown}`);
    assert(!(await first.run(() => document.body.innerText)).includes('examples:'), 'comments for .ci/examples do not show');

    const frames = await openPage(browser, `${server}/${versions[0]}/docs/guide/glossary/`);
    const all = await pages(versions[0]);
    assert(all.length > 50, `${all.length} pages`);
    for (const path of all) {
        const { over, from } = await frames.run(inFrame, server + path, NARROW);
        assert(over <= 0, `${path} is ${over} pixels too wide for a page of ${NARROW}`);
        assert(from.some((url) => url.includes('/assets/')), `${path}: what it loads is not known`);
        assert.deepEqual(from.filter(isElsewhere), [], `${path} loads something from elsewhere`);
    }
    assert((await frames.run(inFrame, server + all[0], 100)).over > 0, 'control: no page is 100 pixels wide');

    const model = `${server}/${versions[0]}/docs/MODEL/`;
    const { all: typeset, blocks, failed, fonts, marked, hidden, hiddenWithoutStyle } = await (await openPage(browser, model)).run(equations);
    assert(typeset >= 300 && blocks >= 25 && typeset === marked, `${typeset} equations of ${marked}, ${blocks} of them blocks`);
    assert.equal(failed, 0, 'equations that failed');
    assert(fonts >= 3 && hidden, `${fonts} fonts of equations; their MathML is hidden: ${hidden}`);
    assert(!hiddenWithoutStyle, 'control: the style sheet hides the MathML');
    assert.equal((await (await openPage(browser, `${server}/${versions[0]}/docs/guide/light/`)).run(equations)).all, 0, 'control: a page without equations');
    const { scrolling, unboxed } = await frames.run(inFrame, model, NARROW);
    assert(scrolling > 0 && unboxed > 0, `${scrolling} long equations scroll; control: without that the page is ${unboxed} pixels too wide`);

    // The control: without the list of versions there is no selector. The other name of the host is another origin, so the browser has no copy of the list.
    await rename(join(folder, 'versions.json'), join(folder, 'versions.away'));
    const without = await openPage(browser, `${server.replace('127.0.0.1', 'localhost')}/${versions[0]}/docs/guide/light/`);
    assert.deepEqual(await without.run(selector, 1500), []);
    console.log(`the version selector lists ${versions.join(', ')}; ${typeset} equations; ${all.length} pages fit ${NARROW} pixels and load nothing from elsewhere`);
} finally {
    await browser.close();
}
