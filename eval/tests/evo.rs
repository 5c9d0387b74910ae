//! Agreement with the PyPI package `evo` 1.38.1 on the same files.
//!
//! The trajectories in `golden/` are synthetic: a smooth path at 50 Hz, and an estimate of it at 30 Hz with
//! another frame and scale, drift, noise and a gap. The numbers are what `evo_ape` and `evo_rpe` print with
//! `--t_max_diff 0.02`, alignment by `-a`, `-s` and `-as`, `-u f`, and `-r angle_deg` for rotations.

use eval::{AlignMode, Delta, Options, Statistics, evaluate, read_trajectory};
use std::path::Path;

const TOLERANCE: f64 = 1e-6;

/// One call of each tool; numbers are rmse, mean, median, std, min, max, sse.
struct Golden {
    form: &'static str,
    /// Whether the estimate, which has fewer poses, is taken as the truth.
    swapped: bool,
    align: AlignMode,
    delta: usize,
    all_pairs: bool,
    ate: [f64; 7],
    rpe: [f64; 7],
    deg: [f64; 7],
}

#[rustfmt::skip]
const GOLDEN: [Golden; 9] = [
    Golden { form: "tum", swapped: false, align: AlignMode::None, delta: 1, all_pairs: false,
        ate: [3.226867480, 3.226429983, 3.243123084, 0.053134710, 3.139406163, 3.319292195, 322.792885673],
        rpe: [0.029355874, 0.023578298, 0.018604377, 0.017488030, 0.003323409, 0.095864002, 0.025853019],
        deg: [0.992713537, 0.911050904, 1.006209807, 0.394292299, 0.266954311, 1.920734042, 29.564404982] },
    Golden { form: "tum", swapped: false, align: AlignMode::Se3, delta: 5, all_pairs: true,
        ate: [0.131181774, 0.115658991, 0.102152320, 0.061900368, 0.046960503, 0.315779234, 0.533468390],
        rpe: [0.126204555, 0.109191621, 0.093073013, 0.063283327, 0.040380246, 0.247977291, 0.414117329],
        deg: [0.958992540, 0.889693165, 0.930691487, 0.357928434, 0.305128419, 1.686378775, 23.911333991] },
    Golden { form: "tum", swapped: false, align: AlignMode::Sim3, delta: 3, all_pairs: false,
        ate: [0.019205823, 0.017988901, 0.018854017, 0.006727783, 0.004174236, 0.033141191, 0.011434773],
        rpe: [0.012481752, 0.011463074, 0.011678918, 0.004938833, 0.002986073, 0.022208938, 0.001557941],
        deg: [0.924650682, 0.830469886, 0.783828659, 0.406569371, 0.284341648, 1.528740463, 8.549788841] },
    Golden { form: "tum", swapped: false, align: AlignMode::Scale, delta: 4, all_pairs: true,
        ate: [8.368124273, 8.367671861, 8.341468775, 0.087014208, 8.278009552, 8.595018821, 2170.790619436],
        rpe: [0.015842638, 0.014375187, 0.013002873, 0.006659067, 0.004156613, 0.028448385, 0.006776708],
        deg: [1.052519853, 0.961972246, 0.967597873, 0.427091839, 0.322444411, 1.804548565, 29.910547126] },
    Golden { form: "kitti", swapped: false, align: AlignMode::None, delta: 1, all_pairs: false,
        ate: [3.226867446, 3.226429950, 3.243123114, 0.053134712, 3.139405872, 3.319291923, 322.792879016],
        rpe: [0.029355919, 0.023578271, 0.018604819, 0.017488141, 0.003323414, 0.095864571, 0.025853099],
        deg: [0.992727948, 0.911069705, 1.006206567, 0.394285141, 0.267060651, 1.920741301, 29.565263382] },
    Golden { form: "kitti", swapped: false, align: AlignMode::Se3, delta: 5, all_pairs: true,
        ate: [0.131181714, 0.115658927, 0.102151722, 0.061900362, 0.046960619, 0.315778779, 0.533467906],
        rpe: [0.126204528, 0.109191612, 0.093072803, 0.063283291, 0.040380673, 0.247977747, 0.414117158],
        deg: [0.959024135, 0.889725494, 0.930736069, 0.357932726, 0.305121807, 1.686412073, 23.912909569] },
    Golden { form: "kitti", swapped: false, align: AlignMode::Sim3, delta: 3, all_pairs: false,
        ate: [0.019205740, 0.017988810, 0.018853592, 0.006727789, 0.004174569, 0.033140718, 0.011434673],
        rpe: [0.012481800, 0.011463108, 0.011679763, 0.004938874, 0.002985466, 0.022209064, 0.001557953],
        deg: [0.924634647, 0.830464177, 0.783826114, 0.406544562, 0.284389430, 1.528699456, 8.549492302] },
    Golden { form: "kitti", swapped: false, align: AlignMode::Scale, delta: 4, all_pairs: true,
        ate: [8.368120652, 8.367668240, 8.341464853, 0.087014183, 8.278005682, 8.595014895, 2170.788740734],
        rpe: [0.015842470, 0.014375123, 0.013003147, 0.006658805, 0.004156165, 0.028446631, 0.006776564],
        deg: [1.052547159, 0.961990201, 0.967612277, 0.427118690, 0.322418987, 1.804617478, 29.912099106] },
    Golden { form: "tum", swapped: true, align: AlignMode::Sim3, delta: 1, all_pairs: false,
        ate: [0.007773614, 0.007265190, 0.007362374, 0.002765156, 0.002109950, 0.013732740, 0.001873301],
        rpe: [0.002456603, 0.002223982, 0.002228983, 0.001043458, 0.000212820, 0.004785640, 0.000181047],
        deg: [0.992713537, 0.911050904, 1.006209807, 0.394292299, 0.266954311, 1.920734042, 29.564404982] },
];

#[test]
fn numbers_agree_with_evo() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    for golden in &GOLDEN {
        let read = |name: &str| read_trajectory(&folder.join(format!("{name}.{}", golden.form))).unwrap();
        let (mut estimate, mut truth) = (read("estimate"), read("truth"));
        if golden.swapped {
            std::mem::swap(&mut estimate, &mut truth);
        }
        let options = Options {
            align: golden.align,
            delta: Delta::Frames(golden.delta),
            all_pairs: golden.all_pairs,
            ..Options::default()
        };
        let found = evaluate(estimate, truth, None, &options).unwrap();
        let rpe = found.rpe.unwrap();
        let pairs = [(found.ate, golden.ate), (rpe.translation, golden.rpe), (rpe.rotation_deg, golden.deg)];
        for (name, (found, expected)) in ["ATE", "RPE", "RPE deg"].into_iter().zip(pairs) {
            let difference = largest_difference(&found, &expected);
            assert!(
                difference < TOLERANCE,
                "{} {:?} {name}: {found:?} differs from {expected:?} by {difference}",
                golden.form,
                golden.align
            );
        }
    }
}

fn largest_difference(s: &Statistics, expected: &[f64; 7]) -> f64 {
    let found = [s.rmse, s.mean, s.median, s.std, s.min, s.max, s.sse];
    found.iter().zip(expected).map(|(f, e)| (f - e).abs()).fold(0.0, f64::max)
}
