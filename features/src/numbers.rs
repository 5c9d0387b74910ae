//! Transcendental functions of our own, so that features are the same to the bit on every machine: those of the
//! system's mathematical library differ between its versions in the last digit.

use std::f64::consts::{LN_2, TAU};

/// `eˣ` for x ≤ 700; relative error below 1e-12, 0 below −700.
pub fn exp(x: f64) -> f64 {
    if x < -700.0 {
        return 0.0;
    }
    let whole = (x / LN_2).round();
    let rest = x - whole * LN_2;
    // Taylor's series; |rest| ≤ 0.35.
    let mut sum = 1.0;
    for n in (1..=12).rev() {
        sum = 1.0 + sum * rest / f64::from(n);
    }
    sum * power_of_two(whole as i32)
}

/// `2ˣ` for |x| ≤ 100.
pub fn exp2(x: f64) -> f64 {
    let whole = x.ceil();
    exp((x - whole) * LN_2) * power_of_two(whole as i32)
}

/// `2ⁿ` for −1022 ≤ n ≤ 1023.
fn power_of_two(n: i32) -> f64 {
    f64::from_bits(((n + 1023) as u64) << 52)
}

/// Sine and cosine of an angle in turns, −1 to 1; error below 1e-9.
pub fn sin_cos(turns: f64) -> (f64, f64) {
    let quarter = (turns * 4.0).round();
    let rest = (turns - quarter / 4.0) * TAU;
    // Taylor's series; |rest| ≤ π/4.
    let square = rest * rest;
    let (mut sine, mut cosine) = (1.0, 1.0);
    for n in (1..=6).rev() {
        let n = f64::from(2 * n);
        sine = 1.0 - sine * square / (n * (n + 1.0));
        cosine = 1.0 - cosine * square / (n * (n - 1.0));
    }
    sine *= rest;
    match quarter.rem_euclid(4.0) as u32 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

/// The direction of a vector from x towards y in turns, 0 to 1; 0 for the vector of length zero. Error below 2e-6.
///
/// Without branches, for the compiler to work on several at once. The arcus tangent on 0–1 is the polynomial that
/// minimises the largest error (Hastings 1955, sheet 13).
#[inline(always)]
pub fn direction(x: f32, y: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let z = small / if large > 0.0 { large } else { 1.0 };
    let s = z * z;
    let radians = z
        * (0.999_977_26
            + s * (-0.332_623_47
                + s * (0.193_543_46 + s * (-0.116_432_87 + s * (0.052_653_32 - s * 0.011_721_2)))));
    let turns = radians * (1.0 / std::f32::consts::TAU);
    let turns = if ax < ay { 0.25 - turns } else { turns };
    let turns = if x < 0.0 { 0.5 - turns } else { turns };
    if y < 0.0 { 1.0 - turns } else { turns }
}

/// The whole number nearest to one from zero to 2²², without the care for others that a cast takes.
#[inline(always)]
pub fn rounded(value: f32) -> u32 {
    // There a number's last bit counts ones.
    const ONES: f32 = (1 << 23) as f32;
    (value + ONES).to_bits() & ((1 << 23) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_are_those_of_the_library() {
        for i in 0..=1000 {
            let t = f64::from(i) / 1000.0;
            assert!((exp(-20.0 * t) / (-20.0 * t).exp() - 1.0).abs() < 1e-12, "{t}");
            assert!((exp2(8.0 * t - 4.0) / (8.0 * t - 4.0).exp2() - 1.0).abs() < 1e-12, "{t}");
            let (sine, cosine) = sin_cos(2.0 * t - 1.0);
            let angle = (2.0 * t - 1.0) * TAU;
            assert!((sine - angle.sin()).abs() < 1e-9 && (cosine - angle.cos()).abs() < 1e-9, "{t}");
            let (x, y) = ((TAU * t).cos() as f32, (TAU * t).sin() as f32);
            let off = f64::from(direction(x, y)) - t;
            assert!((off - off.round()).abs() < 3e-6, "{t}: {off}");
        }
        assert_eq!(exp(-1e9), 0.0);
        assert_eq!(direction(0.0, 0.0), 0.0);
    }
}
