//! The first motion of a sensor that may already be moving.
//!
//! A recording can begin in a car at full speed, farther between two sweeps than any registration reaches. Both sweeps
//! are then distorted in nearly the same way, so that they fit each other as rigid clouds: displacements on a grid are
//! tried so, the best ones registered, and the one kept in which most points find their surface.

use crate::motion::{Sweep, SweepMotion};
use crate::registration::{Prediction, Registration, RegistrationParams, agreement, register};
use crate::surfaces::SurfaceMap;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};

/// Fastest start, metres a second: a car on a motorway.
const FASTEST: f64 = 40.0;
/// Displacements tried lie this far apart, metres: within the reach of a registration.
const STEP: f64 = 0.5;
/// So many of the best are registered.
const REGISTERED: usize = 4;
/// A motion is preferred to rest when so much more of the points agree.
const MARGIN: f64 = 0.01;

/// `first_from_second` of two sweeps of which the first makes `map`, both taken as rigid. `used` are the points of
/// the second that are compared, by index.
pub(crate) fn first_displacement(
    second: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    seconds: f64,
    params: &RegistrationParams,
) -> Se3 {
    let rigid =
        Sweep { shares: vec![0.5; second.points.len()], points: second.points.clone(), ..Sweep::default() };
    let motion =
        |x: f64, y: f64| SweepMotion::resting(Se3::new(UnitQuaternion::identity(), Vector3::new(x, y, 0.0)));
    let reach = (FASTEST * seconds / STEP).round().min(12.0) as i32;
    let mut tested = Vec::new();
    for i in -reach..=reach {
        for j in -reach..=reach {
            if i * i + j * j <= reach * reach {
                let motion = motion(f64::from(i) * STEP, f64::from(j) * STEP);
                tested.push((
                    agreement(&rigid, used, map, &motion, 2.0 * params.kernel),
                    i * i + j * j,
                    motion,
                ));
            }
        }
    }
    // The best first, of equal ones the slowest.
    tested.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let rest = SweepMotion::resting(Se3::identity());
    let mut best: Option<(f64, Registration)> = None;
    for motion in
        std::iter::once(rest).chain(tested.into_iter().take(REGISTERED).map(|(_, _, motion)| motion))
    {
        let prediction = Prediction { motion, begin: (STEP, 0.1), displacement: (1e-6, 1e-6) };
        let registration = register(&rigid, used, map, &prediction, params);
        let score = agreement(&rigid, used, map, &registration.motion, params.kernel);
        if best.as_ref().is_none_or(|(least, _)| score > least + MARGIN) {
            best = Some((score, registration));
        }
    }
    best.map_or_else(Se3::identity, |(_, registration)| registration.motion.begin)
}
