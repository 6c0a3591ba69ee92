//! Sheen: cloth brightens towards its rims, where upright fibres catch light. One number `s` per Gaussian scales its diffuse
//! term by the angle of view alone: `exp(s (1 - n . v)^3)`. The gain is positive and smooth for every `s`; 0 is Lambert.
//!
//! A microfibre model also depends on the light's angle of incidence. This model omits it: a whole sky averages it.

use crate::light::MAX_SHEEN;

/// Gain of the diffuse term with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sheen {
    /// The gain.
    pub gain: f32,
    /// Derivative by the Gaussian's sheen.
    pub by_sheen: f32,
    /// Derivative by `n . v`.
    pub by_nov: f32,
}

impl Sheen {
    /// The gain of `sheen` seen at the cosine `nov`, 0 to 1.
    pub fn new(sheen: f32, nov: f32) -> Self {
        let (away, held) = (1.0 - nov, sheen.clamp(-MAX_SHEEN, MAX_SHEEN));
        let cube = away * away * away;
        let gain = (held * cube).exp();
        Self {
            gain,
            by_sheen: if held == sheen { gain * cube } else { 0.0 },
            by_nov: -3.0 * held * away * away * gain,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_sheen_has_gain_one_and_derivatives_match_differences() {
        for nov in [0.0, 0.3, 1.0] {
            assert_eq!(Sheen::new(0.0, nov).gain, 1.0);
        }
        let (step, at) = (1e-3, Sheen::new(0.7, 0.2));
        let numeric = |f: &dyn Fn(f32) -> f32| (f(step) - f(-step)) / (2.0 * step);
        assert!((numeric(&|h| Sheen::new(0.7 + h, 0.2).gain) - at.by_sheen).abs() < 1e-3);
        assert!((numeric(&|h| Sheen::new(0.7, 0.2 + h).gain) - at.by_nov).abs() < 1e-3);
        assert!(at.by_sheen > 0.1 && at.by_nov < -0.1, "the control: neither is flat here");
    }

    #[test]
    fn sheen_gain_is_bounded() {
        let wild = Sheen::new(1e30, 0.0);
        assert_eq!((wild.gain, wild.by_sheen), (MAX_SHEEN.exp(), 0.0));
        assert!(Sheen::new(-1e30, 0.0).gain > 0.04 && Sheen::new(1e30, 1.0).gain == 1.0);
    }
}
