// Sheen, the gain of the diffuse term at grazing view: the port of crates/scene/src/light/sheen.rs, a part of
// `shading`.
#import generated/light

struct Sheen {
    gain: f32,
    // Derivatives by the Gaussian's sheen and by n.v.
    by_sheen: f32,
    by_nov: f32,
}

fn sheen_of(sheen: f32, nov: f32) -> Sheen {
    let away = 1.0 - nov;
    let held = clamp(sheen, -MAX_SHEEN, MAX_SHEEN);
    let cube = away * away * away;
    let gain = exp(held * cube);
    return Sheen(gain, select(0.0, gain * cube, held == sheen), -3.0 * held * away * away * gain);
}
