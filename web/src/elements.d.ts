import type { RelumeViewer } from './viewer/element'

declare module 'preact' {
  namespace JSX {
    interface IntrinsicElements {
      /** The viewer; see the class `RelumeViewer`. */
      'relume-viewer': HTMLAttributes<RelumeViewer> & {
        model: string
        environment?: string
        rotation?: string
        exposure?: string
        background?: string
        output?: string
        'auto-rotate'?: string | undefined
        photographed?: string | undefined
        azimuth?: number
        elevation?: number
        distance?: number
        fov?: number
        target?: string
        apiKey?: string | undefined
        share?: string | undefined
      }
    }
  }
}
