import { defineConfig } from 'vite'

/** Where `npm run dev` finds a server. */
const server = process.env.RELUME_SERVER ?? 'http://127.0.0.1:7878'

export default defineConfig({
  // Relative, so that the page also works below a path of a proxy.
  base: './',
  build: {
    target: 'es2022',
    // A page under a strict Content-Security-Policy takes no data: URLs.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    rollupOptions: {
      input: { app: 'index.html', docs: 'docs.html', share: 'share/index.html', 'relume-viewer': 'src/viewer/element.ts' },
      preserveEntrySignatures: 'exports-only',
      output: {
        // Other sites name the viewer, so it keeps its name; all else is named by its content and cached for ever.
        entryFileNames: (chunk) => (chunk.name === 'relume-viewer' ? '[name].js' : 'assets/[name]-[hash].js'),
        chunkFileNames: 'assets/[name]-[hash].js',
        assetFileNames: 'assets/[name]-[hash][extname]',
      },
    },
  },
  server: { proxy: { '/v1': { target: server, changeOrigin: true } } },
})
