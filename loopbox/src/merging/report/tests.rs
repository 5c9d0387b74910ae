use super::*;
use crate::merging::input::InputSeconds;
use crate::merging::record::PairRecords;
use crate::merging::{MergingParams, PairRecord, PairResult, PairResults, Seconds, verdicts};
use crate::swapping::SwapFiles;
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use loopbox_tests::pages::{assert_points_nowhere, embedded, opened};
use map::{AgentId, AgentInfo, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Map, SemiDense};
use merge::acceptance::{Decision, Doubt, Evidence, Verdict};
use merge::alignment::PairPoses;
use merge::closure::{Closure, PairOutcome};
use merge::common_map::{CommonMap, FusionParams, Link};
use merge::estimate::Estimate;
use merge::icp::{IcpRefusal, Side};
use merge::matching::FeatureMatch;
use merge::optimal_scale::{Basis, OptimalScale, OptimalScaleRefusal, PairEstimate};
use merge::pair::{Pair, PairRefusal, ViewPair};
use merge::pairing::Travel;
use merge::point_alignment::PointAlignment;
use merge::scale_filter::{MeasuredPoint, PairScale, PointMatch};
use merge::two_view::{RelativePose, Scene as SceneKind, TwoViewRefusal};
use merge::verification::{EvaluatedClosure, Outcome, Place, TestedPlace};
use nalgebra::{Matrix3, Matrix4, SMatrix, UnitQuaternion, Vector2, Vector3};
use place_recog::features::{Features, Keypoint};
use std::borrow::Cow;
use std::sync::Arc;

const HOSTILE: &str = "</script><script>alert('x')</script>\"&<!-- {{data}} \u{2028}";
const CAMERA: Pinhole = Pinhole { width: 80, height: 60, fx: 60.0, fy: 60.0, cx: 39.5, cy: 29.5 };
/// Features of every keyframe, and matches of every pair.
const FEATURES: usize = 30;

/// A map of `count` keyframes along a line, with a depth at every `spacing`-th pixel; `seed` tells maps apart.
fn line(name: &str, count: u32, spacing: usize, seed: u64) -> Map {
    let mut map = Map::of(AgentInfo::new(name, CAMERA));
    for i in 0..count {
        let at = f64::from(i) * 0.2;
        let pixels: Vec<u8> =
            (0..80 * 60).map(|p| (p * (7 + i as usize + seed as usize) % 251) as u8).collect();
        let pixel: Vec<u32> = (0..80 * 60).step_by(spacing).collect();
        let inverse_depth: Vec<f32> = pixel.iter().map(|p| 0.1 + (p % 97) as f32 * 0.005).collect();
        let variance = inverse_depth.iter().map(|d| (d * 0.02).powi(2)).collect();
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::y() * at * 0.1);
        let id = KeyframeId(i);
        let keyframe = Keyframe {
            id,
            agent: AgentId::default(),
            timestamp: 1000.0 * seed as f64 + at,
            frame_index: u64::from(i) * 3,
            world_from_keyframe: Sim3::new(rotation, Vector3::new(at, 0.0, 0.1 * at), 1.0),
            image: Arc::new(GrayImage::from_vec(80, 60, pixels).unwrap()),
            color: None,
            scan: None,
            semi_dense: SemiDense { pixel: pixel.into(), inverse_depth: inverse_depth.into(), variance }
                .into(),
            points: Vec::new(),
            features: None,
            words: None,
        };
        let timestamp = keyframe.timestamp;
        map.keyframes.insert(id, keyframe);
        map.frames.push(FramePose {
            timestamp,
            frame_index: u64::from(i) * 3,
            reference: id,
            keyframe_from_frame: Se3::identity(),
        });
    }
    for i in 1..count {
        let pose = |i: u32| map.keyframes[&KeyframeId(i)].world_from_keyframe;
        map.edges.push(Edge {
            from: KeyframeId(i - 1),
            to: KeyframeId(i),
            from_from_to: pose(i - 1).inverse() * pose(i),
            information: SMatrix::identity() * 1e4,
            kind: EdgeKind::Odometry,
        });
    }
    map
}

fn pixel(i: usize) -> [f32; 2] {
    [(i * 37 % 80) as f32, (i * 23 % 60) as f32]
}

fn input(name: &str, map: Map) -> Input {
    let keypoints = (0..FEATURES).map(|i| Keypoint { pixel: pixel(i), size: 4.0, angle: 0.0 }).collect();
    let features = Features { keypoints, descriptors: vec![[0; 128]; FEATURES] };
    let features = map.keyframes.keys().map(|id| (*id, features.clone())).collect();
    Input {
        found: 0,
        path: name.into(),
        name: name.to_owned(),
        map: map.into(),
        features: Arc::new(features),
        words: Arc::default(),
        direct: Arc::default(),
        warnings: Vec::new(),
        seconds: InputSeconds::default(),
    }
}

/// Three inputs, the third of which met nobody, as a merging leaves them.
fn merging(names: [&str; 3], count: u32, spacing: usize) -> (Vec<Input>, Merging) {
    let inputs: Vec<Input> =
        names.iter().zip(1..).map(|(name, seed)| input(name, line(name, count, spacing, seed))).collect();
    let maps: Vec<&Map> = inputs.iter().map(|input| &*input.map).collect();
    let (mut common, addresses) = CommonMap::from_maps(&maps).unwrap();
    for i in 0..count.min(3) {
        let address = |input: usize| addresses[input].of(AgentId::default(), KeyframeId(i)).unwrap();
        let from_from_to = Estimate { a_from_b: Sim3::identity(), information: SMatrix::identity() * 1e4 };
        assert!(common.link(Link { from: address(0), to: address(1), from_from_to }));
    }
    let fused = common.fuse(&FusionParams::default()).unwrap();
    let graph = common.graph(&FusionParams::default()).unwrap();
    let refused = |target| PairResult {
        target,
        source: 2,
        proposed: 5,
        tested: [tested(Outcome::NotMatched(TwoViewRefusal::TooFewMatches { given: 3, needed: 16 }))].into(),
        joined: None,
        error: None,
        seconds: Seconds::default(),
        seen: None,
    };
    let accepted = evaluated(Decision::Accepted);
    let met = PairResult { source: 1, tested: [tested(accepted)].into(), ..refused(0) };
    (
        inputs,
        Merging {
            pair_results: Arc::new([met, refused(0), refused(1)].into_iter().collect()),
            addresses,
            common,
            graph,
            fused,
            taken_back: Vec::new(),
            fusion_seconds: 0.1,
        },
    )
}

fn tested(outcome: Outcome) -> TestedPlace {
    let place = Place { source: KeyframeId(1), target: KeyframeId(1) };
    TestedPlace { place, matched: 30, match_count: 20, outcome }
}

fn evidence() -> Evidence {
    Evidence {
        matches: 60,
        pairs: 2,
        pooled: false,
        inlier_share: 0.9,
        total_inlier_share: 0.7,
        rotation_deviation: 0.02,
        translation_deviation: 0.01,
        scale_deviation: f64::INFINITY,
        icp_overlap: None,
        rival_place: None,
        ln_false_alarms: -40.0,
        place: None,
        beyond: None,
    }
}

fn evaluated(decision: Decision) -> Outcome {
    let verdict = Verdict { evidence: evidence(), lines: Vec::new(), decision, is_confirmed: false };
    Outcome::Evaluated(Box::new(EvaluatedClosure { closure: closure(), joined: None, verdict }))
}

/// A closure whose first pair was not measured and whose last is missing; every third match of the centre has depth.
fn closure() -> Closure {
    let estimate = Estimate { a_from_b: Sim3::identity(), information: SMatrix::identity() };
    let outcome = |measured| PairOutcome {
        source: KeyframeId(1),
        target: KeyframeId(1),
        measured,
        direct: None,
        motion: Some(estimate),
        agrees: true,
    };
    let scale = OptimalScale {
        scale: 1.3,
        variance: 1e-4,
        basis: Basis::Single,
        used: [false, true, false],
        scale_gap: 0.0,
        match_count: 20.0,
    };
    let unmeasured = PairRefusal::RelativePose(TwoViewRefusal::TooFewMatches { given: 2, needed: 16 });
    Closure {
        travel: Travel::Opposite,
        pairs: [Some(outcome(Err(unmeasured))), Some(outcome(Ok(pair()))), None],
        chosen: 1,
        pooled: None,
        scales: [None, Some(PairEstimate { scale: 1.3, variance: 1e-4, match_count: 20 }), None],
        scale,
        algorithm_1: Err(OptimalScaleRefusal::NoEstimate),
        poses: PairPoses {
            source_world_from_source: Sim3::identity(),
            target_world_from_target: Sim3::identity(),
        },
        initial_guess: Sim3::identity(),
        registration: Err(IcpRefusal::TooFew { side: Side::Source, given: 3, needed: 50 }),
        motion: estimate,
        at_keyframes: estimate,
        reach: 1.0,
    }
}

fn pair() -> Pair {
    let point = |i: usize| {
        let [x, y] = pixel(i).map(f64::from);
        MeasuredPoint::unproject(&CAMERA, Vector2::new(x, y), 0.3, 0.25, 1e-4).unwrap()
    };
    let matches = (0..FEATURES as u32).map(|i| FeatureMatch { source: i, target: i, squared_distance: 9 });
    let points: Vec<PointMatch> =
        (0..FEATURES).step_by(3).map(|i| PointMatch { source: point(i), target: point(i) }).collect();
    Pair {
        views: ViewPair {
            source: KeyframeId(1),
            target: KeyframeId(1),
            matches: matches.collect(),
            relative_pose: RelativePose {
                target_from_source: UnitQuaternion::identity(),
                rotation_covariance: Matrix3::identity(),
                direction: None,
                scene: SceneKind::NoParallax,
                inliers: (0..FEATURES).collect(),
                ln_false_alarms: -40.0,
                parallax: 0.0,
                rmse: 0.4,
            },
        },
        direction_gap: None,
        alignment: PointAlignment {
            target_from_source: Sim3::identity(),
            information: SMatrix::identity(),
            inliers: vec![true; points.len()],
            inlier_count: points.len(),
            normalised_error: 1.0,
        },
        points,
        scale: PairScale {
            scale: 1.3,
            variance: 1e-4,
            translation: Vector3::zeros(),
            covariance: Matrix4::identity(),
            distance_ratio: 1.3,
            used: 10,
            gated: 0,
        },
    }
}

const NAMES: [&str; 3] = ["yard", "street", "attic"];

fn page_of((inputs, merging): &(Vec<Input>, Merging)) -> String {
    let mut page = Vec::new();
    render(inputs, merging, &mut page).unwrap();
    String::from_utf8(page).unwrap()
}

#[test]
fn nothing_points_outside() {
    let page = page_of(&merging(NAMES, 4, 9));
    assert_points_nowhere(&page);
    assert!(!page.contains("{{"), "a mark is left");
}

#[test]
fn hostile_names_stay_text() {
    let (plain, hostile) = (page_of(&merging(NAMES, 3, 9)), page_of(&merging([HOSTILE, "b", "c"], 3, 9)));
    for mark in ["<script", "</script", "<!--", "</title"] {
        assert_eq!(hostile.matches(mark).count(), plain.matches(mark).count(), "{mark}");
    }
    let data = embedded(&hostile);
    assert_eq!(data["inputs"][0], HOSTILE);
    assert_eq!(data["scene"]["agents"][0]["name"], HOSTILE);
}

#[test]
fn the_first_map_s_component_is_displayed_and_the_others_are_named() {
    let data = embedded(&page_of(&merging(NAMES, 4, 9)));
    let names: Vec<&str> = data["scene"]["agents"]
        .as_array()
        .unwrap()
        .iter()
        .map(|agent| agent["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["yard", "street"]);
    assert_eq!(data["scene"]["agents"][1]["color"], serde_json::json!(map::agent_color(AgentId(1))));
    assert_eq!(data["scene"]["keyframes"]["count"], 8);
    assert_eq!(data["others"][0]["names"][0], "attic");
    assert_eq!(data["graph"]["agents"][1]["way"], serde_json::json!([0, 1]));
    assert_eq!(data["graph"]["merges"][0]["closures"], 3);
    assert_eq!(data["graph"]["merges"][0]["in_tree"], true);
}

#[test]
fn every_pair_has_its_verdict() {
    let data = embedded(&page_of(&merging(NAMES, 4, 9)));
    let pair_reports = data["meetings"].as_array().unwrap();
    assert_eq!(pair_reports.len(), 3);
    assert!(pair_reports[0]["refusal"].is_null());
    assert_eq!(pair_reports[1]["refusal"], "3 matches are too few: at least 16 are needed.");
    let pairs = &pair_reports[0]["closure"]["pairs"];
    assert!(pairs[0]["matches"].is_null() && pairs[0]["verdict"].as_str().unwrap().contains("too few"));
    assert_eq!(pairs[1]["matches"]["count"], FEATURES);
    assert_eq!(pairs[1]["matches"]["with_depth"], FEATURES / 3);
    assert!(pairs[2].is_null());
    // The second agent's keyframes follow those of the first.
    assert_eq!(pairs[1]["keyframes"]["in_scene"], serde_json::json!([5, 1]));
    // No JSON number is infinite: it is left out.
    assert!(pair_reports[0]["closure"]["evidence"]["scale_deviation"].is_null());
}

#[test]
fn a_doubted_closure_is_listed_with_its_doubt() {
    let mut merging = merging(NAMES, 4, 9);
    let doubt = Doubt::Unconfirmed { pairs: 1, needed: 2 };
    let met = merging.1.pair_results.get([0, 1]).unwrap().into_owned();
    let doubted = PairResult { tested: [tested(evaluated(Decision::Undecided(doubt)))].into(), ..met };
    Arc::make_mut(&mut merging.1.pair_results).insert(doubted);
    let data = embedded(&page_of(&merging));
    assert_eq!(data["meetings"][0]["closure"]["accepted"], false);
    assert_eq!(data["meetings"][0]["refusal"].as_str().unwrap().chars().next(), Some('O'));
}

#[test]
fn what_rests_is_written_to_the_byte_as_what_is_in_memory() {
    let (inputs, mut merging) = merging(NAMES, 4, 9);
    let written = |merging: &Merging| {
        let record = serde_json::to_string_pretty(&PairRecords::new(&inputs, merging)).unwrap();
        let mut page = Vec::new();
        render(&inputs, merging, &mut page).unwrap();
        let said: String = verdicts(&inputs, merging).collect();
        (record, page, said, merging.provenance(&inputs, &MergingParams::default()))
    };
    let in_memory = written(&merging);
    let mut resting = PairResults::resting(Arc::new(SwapFiles::beyond("/nonexistent".into(), 0)));
    merging.pair_results.iter().for_each(|pair_result| resting.insert(pair_result.into_owned()));
    merging.pair_results = resting.into();
    assert!(
        merging.pair_results.iter().all(|pair_result| matches!(pair_result, Cow::Owned(_))),
        "none rests"
    );
    assert!(written(&merging) == in_memory);
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let merging = merging(NAMES, 4, 3);
    assert_eq!(page_of(&merging), page_of(&merging));
}

#[test]
fn odd_and_empty_maps_make_pages_too() {
    let mut odd = merging(NAMES, 3, 50);
    let keyframe = odd.1.fused[0].map.keyframes.values_mut().next().unwrap();
    keyframe.world_from_keyframe.scale = f64::NAN;
    for input in &mut odd.0 {
        let map = Arc::make_mut(&mut input.map);
        map.keyframes.values_mut().for_each(|keyframe| keyframe.image = Arc::default());
    }
    let data = embedded(&page_of(&odd));
    assert_eq!(data["scene"]["keyframes"]["count"], 5);
    assert_eq!(data["pictures"].as_array().unwrap().len(), 0);
    let empty = embedded(&page_of(&merging(NAMES, 0, 1)));
    assert_eq!(empty["cloud"]["count"], 0);
    assert_eq!(empty["others"].as_array().unwrap().len(), 2);
}

#[test]
fn a_browser_shows_it() {
    for merging in [merging([HOSTILE, "b", "c"], 4, 5), merging(NAMES, 0, 1)] {
        let Some(dom) = opened(&page_of(&merging)) else {
            eprintln!("SKIPPED: no Chromium here, the report was not opened in a browser");
            return;
        };
        let works =
            ["complete", "without-3d"].iter().any(|how| dom.contains(&format!(r#"data-report="{how}""#)));
        assert!(works, "the page's scripts did not run to their end");
        assert_eq!(dom.matches("class=\"meeting\"").count(), 3);
    }
}

/// Programs and pages read these, and verdicts that were kept: the code may call them otherwise.
#[test]
fn keys_of_results_stay() {
    let (inputs, merging) = merging(["a", "b", "c"], 5, 1);
    let record =
        serde_json::to_value(PairRecord::new(&merging.pair_results.get([0, 1]).unwrap(), &inputs)).unwrap();
    for key in ["/tried/0/outcome", "/seconds/meeting", "/closure/evidence/agreeing_share"] {
        assert!(record.pointer(key).is_some(), "no {key} in {record:#}");
    }
    let kept = serde_json::to_value(tested(evaluated(Decision::Accepted))).unwrap();
    assert!(kept.pointer("/outcome/Judged/verdict/evidence/agreeing_share").is_some(), "{kept:#}");
    let params = serde_json::to_value(MergingParams::default()).unwrap();
    for key in ["/meeting/acceptance/min_agreeing_share", "/meeting/acceptance/min_untold_change"] {
        assert!(params.pointer(key).is_some(), "no {key} in {params:#}");
    }
    let lidars = serde_json::to_value(slam_lidar::merging::comparison::Comparison::default()).unwrap();
    assert!(lidars.get("agreeing").is_some(), "{lidars:#}");
}
