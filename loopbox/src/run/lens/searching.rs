//! The search for a lens: from which focal lengths it is begun, and whether it is found again.

use super::{DETERMINED, FoundLens, Guess, MAX_ROUNDS, USUAL_SPREAD, centred, left_to_the_map, refined};
use anyhow::Result;
use geometry::{Camera, Pinhole};
use map::Map;
use slam_direct::Params;
use slam_direct::self_calibration::{SelfCalibration, SelfCalibrationError};
use sources::Stop;
use sources::correction::doubled_camera;

/// A lens is searched again from a focal length that is larger or smaller by this factor. What a recording determines is found again to
/// 1 % from there; of two of thirteen parts of recordings that were searched, it was not, and they were 17 and 39 % off.
const OTHER_START: f64 = 1.25;
/// What the focal lengths found err by besides, as a deviation of the logarithm: the root mean square over ten parts of four recordings by real
/// cameras (0.1 to 2.9 %), which agree with themselves to 0.0 to 1.7 %. Lenses bend light in other ways than two radial terms, and shutters
/// roll.
const UNMODELLED: f64 = 0.015;

/// How far a focal length that is not found again is off, over how far apart the searches end: 2.7, the root mean square over seven parts of a
/// robot's drive by a real camera, of which all find it too short.
const FARTHER_OFF: f64 = 3.0;

/// How a lens is searched.
pub(super) struct Search<'a> {
    /// Size of the images as they come, which are halved so many
    pub whole: (usize, usize),
    /// times.
    pub times: usize,
    pub params: &'a Params,
    /// The map that a lens leads to; with the number of the round.
    pub map_with: &'a dyn Fn(&Camera, usize) -> Result<Map>,
    pub stop: &'a Stop,
    /// Whether it is searched again from another focal length.
    pub is_repeated: bool,
}

impl Search<'_> {
    /// The lens by the first of these guesses that leads to one; what was stated, where the maps know less; else why there is none.
    pub(super) fn by(
        &self,
        guesses: impl Iterator<Item = Guess>,
    ) -> Result<Result<FoundLens, SelfCalibrationError>> {
        let (whole, times) = (self.whole, self.times);
        let (mut why, mut kept) = (SelfCalibrationError::Undetermined, None);
        for guess in guesses {
            let size = (whole.0 >> times, whole.1 >> times);
            let start = centred(guess.focal, size)?;
            let as_found = |camera: &Camera, focal_deviation: f64| -> Result<FoundLens> {
                let camera = doubled_camera(camera, whole, times)?;
                Ok(FoundLens { camera, focal_deviation, stated: guess.stated.clone() })
            };
            let found = refined(&start, guess.spread, self.map_with, self.stop)?;
            match (found, guess.stated.is_some()) {
                (Ok(found), is_stated) => {
                    let found = self.repeated(found, &start)?;
                    if is_stated && found.focal_deviation > guess.spread {
                        return Ok(Ok(as_found(&start, guess.spread)?));
                    }
                    if found.focal_deviation >= guess.spread {
                        let (focal, deviation) = weighed(&found, &guess);
                        return Ok(Ok(as_found(&centred(focal, size)?, deviation)?));
                    }
                    let camera = left_to_the_map(&found, self.params)?;
                    return Ok(Ok(as_found(&camera, found.focal_deviation.hypot(UNMODELLED))?));
                }
                (Err(SelfCalibrationError::Undetermined), true) => {
                    return Ok(Ok(as_found(&start, guess.spread)?));
                }
                // Another lens may make a larger map.
                (Err(_), true) => kept = Some(as_found(&start, guess.spread)?),
                (Err(error), false) => why = error,
            }
        }
        Ok(kept.ok_or(why))
    }

    /// The lens that was found from `start`, held against the one that is found from its other side and, where these do not agree, from
    /// farther on this side. What each says of itself is how well the observations of a map agree, and these depend on the lens that
    /// the map was made with. A lens that is not found again is a guess.
    fn repeated(&self, found: SelfCalibration, start: &Camera) -> Result<SelfCalibration> {
        if !self.is_repeated || found.focal_deviation >= DETERMINED || self.stop.requested() {
            return Ok(found);
        }
        let &Pinhole { width, height, fx, .. } = found.camera.intrinsics();
        let is_above = start.intrinsics().fx > fx;
        let sides =
            if is_above { [OTHER_START.recip(), OTHER_START] } else { [OTHER_START, OTHER_START.recip()] };
        let mut all = vec![found];
        for (side, factor) in sides.into_iter().enumerate() {
            let again = |lens: &Camera, round: usize| (self.map_with)(lens, (1 + side) * MAX_ROUNDS + round);
            let start = centred(factor * fx, (width, height))?;
            all.extend(refined(&start, USUAL_SPREAD, &again, self.stop)?.ok());
            match nearest(&all) {
                Some(agreed) if agreed.focal_deviation < DETERMINED || side > 0 => return Ok(agreed),
                _ => {}
            }
        }
        let only = all.swap_remove(0);
        Ok(known_to(only, OTHER_START.ln()))
    }
}

/// Of several lenses that were found from one recording, those two that agree best in the focal length: that of the two whose observations
/// agree better, and its focal length is known no better than [the two agree](known_to). `None` of fewer.
fn nearest(all: &[SelfCalibration]) -> Option<SelfCalibration> {
    let ln_focal = |found: &SelfCalibration| found.camera.intrinsics().fx.ln();
    let pairs = all.iter().enumerate().flat_map(|(i, one)| all[..i].iter().map(move |other| (other, one)));
    let apart = |(one, other): &(&SelfCalibration, &SelfCalibration)| (ln_focal(one) - ln_focal(other)).abs();
    let (one, other) = pairs.min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
    let better = if other.residual < one.residual { other } else { one };
    Some(known_to(better.clone(), apart(&(one, other))))
}

/// A lens that another search finds otherwise by `apart`, the difference of the focal lengths' logarithms: known no better than that where it is
/// found again, and worse where it is not.
fn known_to(found: SelfCalibration, apart: f64) -> SelfCalibration {
    let off = if apart < DETERMINED { apart } else { FARTHER_OFF * apart };
    SelfCalibration { focal_deviation: found.focal_deviation.max(off), ..found }
}

/// The focal length by what was found and by the guess that was begun with, each by how well it is known, and the deviation of its logarithm.
fn weighed(found: &SelfCalibration, guess: &Guess) -> (f64, f64) {
    let [of_found, of_guess] = [found.focal_deviation, guess.spread].map(|deviation| deviation.powi(-2));
    let ln_focal = of_found * found.camera.intrinsics().fx.ln() + of_guess * guess.focal.ln();
    let all = of_found + of_guess;
    ((ln_focal / all).exp(), all.sqrt().recip())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(focal: f64, residual: f64) -> SelfCalibration {
        let camera = centred(focal, (640, 480)).unwrap();
        SelfCalibration { camera, focal_deviation: 0.002, keyframes: 30, observations: 9000, residual }
    }

    /// A lens whose search ends elsewhere from another start is known no better than the two agree, unless a third search ends there.
    #[test]
    fn what_is_not_found_again_is_not_known() {
        let focal = |found: &SelfCalibration| found.camera.intrinsics().fx;
        let same = nearest(&[found(500.0, 1.0), found(501.0, 1.1)]).unwrap();
        assert!(focal(&same) == 500.0 && (same.focal_deviation - 0.002).abs() < 1e-4);
        let apart = [found(636.0, 1.4), found(462.0, 1.1)];
        assert!(nearest(&apart).unwrap().focal_deviation > 0.3);
        // One that agrees with itself best is not the one that is found again.
        let third = nearest(&[found(461.0, 1.3), found(387.0, 1.0), found(464.0, 1.2)]).unwrap();
        assert!(focal(&third) == 464.0 && third.focal_deviation < DETERMINED);
        assert!(nearest(&apart[..1]).is_none());
    }

    #[test]
    fn what_is_known_worse_than_the_guess_is_weighed_with_it() {
        let guess = Guess { focal: 512.0, spread: USUAL_SPREAD, stated: None };
        let by = |deviation: f64| {
            weighed(&SelfCalibration { focal_deviation: deviation, ..found(300.0, 1.0) }, &guess)
        };
        let (focal, deviation) = by(USUAL_SPREAD);
        assert!((focal - (300.0f64 * 512.0).sqrt()).abs() < 1e-9);
        assert!((deviation - USUAL_SPREAD / 2f64.sqrt()).abs() < 1e-9);
        let (focal, deviation) = by(1e6);
        assert!((focal - 512.0).abs() < 1e-6 && (deviation - USUAL_SPREAD).abs() < 1e-6);
    }
}
