mod finished;
mod scene;

use super::*;
use crate::agent::Agent;
use crate::frame::Frame;
use geometry::Sim3;
use geometry::{Pinhole, Se3, umeyama};
use loopbox_tests::{Recording, World, trajectory};
use nalgebra::{SVector, Vector3};
use place_recog::ThumbnailIndex;
use scene::Scene;

/// Half a degree of turn, 0.2 % of scale and 6 mm a keyframe.
fn drift() -> Sim3 {
    Sim3::exp(&SVector::from([0.004, -0.002, 0.004, 0.001, 0.002, -0.001, 0.002]))
}

fn orbit() -> Vec<Se3> {
    trajectory::orbit(60, 4.0, 1.1)
}

fn centres(map: &LocalMap) -> Vec<Vector3<f64>> {
    map.keyframes.iter().map(|k| k.camera_from_world.inverse().translation).collect()
}

/// Root mean square distance from the truth after a similarity.
fn error(positions: &[Vector3<f64>], truth: &[Vector3<f64>]) -> f64 {
    let fit = umeyama::sim3(positions, truth).unwrap();
    let squares: f64 = positions.iter().zip(truth).map(|(p, t)| (fit * *p - t).norm_squared()).sum();
    (squares / positions.len() as f64).sqrt()
}

fn find(scene: &Scene, closer: &mut LoopCloser, keyframe: usize, params: &Params) -> Option<FoundLoop> {
    closer.find(&scene.local, &scene.places, keyframe, params)
}

#[test]
fn a_loop_pulls_a_drifted_map_together() {
    let mut scene = Scene::render(&World::yard(1), &orbit(), 4);
    let truth = centres(&scene.local);
    scene.drift(&drift());
    let before = error(&centres(&scene.local), &truth);
    let params = Params::default();
    let mut closer = LoopCloser::default();
    let found = (54..60).find_map(|k| find(&scene, &mut closer, k, &params)).expect("the loop is found");
    let (newer, older) = found.keyframes();
    assert!(newer.0 >= 54 && older.0 <= 6, "{newer:?} {older:?}");
    closer.start(&scene.local, found, &params);
    let scales: Vec<f64> = scene.local.keyframes.iter().map(|k| k.scale).collect();
    let (closed, moved) = closer.finish(&mut scene.local, &params).unwrap().unwrap();
    assert_eq!(moved.len(), scene.local.keyframes.len());
    assert_eq!(closed.keyframes(), (newer, older));
    let after = error(&centres(&scene.local), &truth);
    assert!(before > 0.15 && after < 0.1 * before, "{before} m before, {after} m after");
    // The scales follow: the injected drift of scale at the newer end is gone.
    let scale = |id: KeyframeId| scene.local.keyframes[id.0 as usize].scale / scales[id.0 as usize];
    let (between, expected) =
        (scale(newer) / scale(older), drift().scale.powi(older.0 as i32 - newer.0 as i32));
    assert!((between / expected - 1.0).abs() < 0.02, "{between} instead of {expected}");
    // Both sides see one place now, so nothing is left to close.
    let shared = scene.local.covisible(newer.0 as usize);
    assert!(shared.iter().any(|&(k, count)| k <= 8 && count >= 40), "{shared:?}");
    assert!(find(&scene, &mut closer, newer.0 as usize, &params).is_none());
    let edges = edges::all(&scene.local, closer.closed());
    assert_eq!(edges.iter().filter(|e| e.kind == map::EdgeKind::Loop).count(), 1);
}

#[test]
fn in_a_large_map_what_is_older_than_the_loop_stays() {
    let mut scene = Scene::render(&World::yard(1), &trajectory::orbit(70, 4.0, 1.3), 4);
    let truth = centres(&scene.local);
    scene.drift(&drift());
    let before = centres(&scene.local);
    let mut params = Params::default();
    params.closing.whole_map = 40;
    let mut closer = LoopCloser::default();
    let found = (66..70).find_map(|k| find(&scene, &mut closer, k, &params)).expect("the loop is found");
    let oldest = *found.old_side.iter().min().unwrap();
    assert!(oldest > 2, "{found:?}");
    closer.start(&scene.local, found, &params);
    let (_, graph) = closer.pending.take().unwrap();
    graph.join().map_err(|refusal| refusal.to_string()).unwrap().apply(&mut scene.local);
    let after = centres(&scene.local);
    assert_eq!(after[..oldest], before[..oldest]);
    assert!((oldest + 1..70).all(|k| after[k] != before[k]));
    // From the oldest of the loop on the map is right to what it was before.
    let [before, after] = [&before, &after].map(|centres| error(&centres[oldest..], &truth[oldest..]));
    assert!(before > 0.15 && after < 0.15 * before, "{before} m before, {after} m after");
}

#[test]
fn a_similar_place_beyond_any_drift_is_refused() {
    let mut scene = Scene::render(&World::yard(1), &trajectory::sideways(40, 12.0), 4);
    (0..8).for_each(|i| scene.copy_appearance(i, 30 + i));
    let mut params = Params::default();
    let mut closer = LoopCloser::default();
    assert!((30..38).all(|k| find(&scene, &mut closer, k, &params).is_none()));
    // It is the way that tells: without its bound the copy is as good as the place itself.
    params.closing.max_drift = 10.0;
    assert!((30..38).any(|k| find(&scene, &mut closer, k, &params).is_some()));
}

#[test]
fn a_loop_that_pulls_a_map_apart_is_taken_back() {
    let mut scene = Scene::render(&World::yard(1), &trajectory::sideways(40, 12.0), 4);
    (0..8).for_each(|i| scene.copy_appearance(i, 30 + i));
    let mut params = Params::default();
    params.closing.max_drift = 10.0;
    let mut closer = LoopCloser::default();
    let found = (30..38).find_map(|k| find(&scene, &mut closer, k, &params)).expect("it looks alike");
    let before = centres(&scene.local);
    closer.start(&scene.local, found, &params);
    let refusal = closer.finish(&mut scene.local, &params).unwrap().unwrap_err();
    assert!(matches!(refusal, NoLoop::TakenBack { .. }), "{refusal}");
    assert_eq!(centres(&scene.local), before);
    assert!(closer.closed().is_empty());
    // Without that line the copy is as good as the place itself.
    params.closing.min_kept = 0.0;
    let found = (30..38).find_map(|k| find(&scene, &mut LoopCloser::default(), k, &params));
    closer.start(&scene.local, found.expect("as before"), &params);
    assert!(closer.finish(&mut scene.local, &params).unwrap().is_ok());
    assert_ne!(centres(&scene.local), before);
}

#[test]
fn a_single_view_of_a_similar_place_is_refused() {
    let mut scene = Scene::render(&World::yard(1), &trajectory::sideways(40, 12.0), 4);
    scene.copy_appearance(4, 34);
    let mut params = Params::default();
    params.closing.max_drift = 10.0;
    let mut closer = LoopCloser::default();
    assert!((30..40).all(|k| find(&scene, &mut closer, k, &params).is_none()));
    let proposal = closer.propose(&scene.local, &scene.places, 34, &params.closing);
    assert!(proposal.is_none(), "a refused place is not tried again at once");
    let fresh = LoopCloser::default();
    let proposal = fresh.propose(&scene.local, &scene.places, 34, &params.closing).unwrap();
    let refusal = evidence::test(&scene.local, &proposal, &params).unwrap_err();
    assert_eq!(refusal, NoLoop::Unconfirmed);
}

#[test]
fn edges_hold_what_the_points_say() {
    let scene = Scene::render(&World::yard(1), &trajectory::sideways(8, 1.6), 3);
    let edges = edges::covisibility(&scene.local, 0);
    assert!((1..8).all(|k| edges.iter().any(|e| (e.from.0, e.to.0) == (k, k - 1))));
    for edge in &edges {
        assert!(edge.from > edge.to && edge.from.0 - edge.to.0 <= 3);
        let [from, to] =
            [edge.from, edge.to].map(|id| scene.local.keyframes[id.0 as usize].camera_from_world);
        assert!((edge.from_from_to * Sim3::from(to * from.inverse())).log().norm() < 1e-9);
        let covariance = edge.information.cholesky().expect("positive definite").inverse();
        let sigma = covariance.diagonal().map(f64::sqrt);
        // Hundreds of points 3–8 m away, half a pixel each: millimetres, hundredths of a degree, per mille.
        assert!(
            sigma.rows(0, 3).amax() < 0.02 && sigma.rows(3, 3).amax() < 2e-3 && sigma[6] < 5e-3,
            "{sigma}"
        );
        assert!(sigma.rows(0, 3).amin() > 1e-5, "{sigma}");
    }
}

#[test]
fn the_agent_closes_the_loop_that_a_wrong_focal_length_opens() {
    let recording =
        Recording::render(&World::yard(1), Recording::SMALL_CAMERA, &trajectory::orbit(300, 4.0, 1.15), 30.0);
    // A focal length 3 % too long bends an orbit by several degrees.
    let camera = Pinhole { fx: 216.0, fy: 216.0, ..Recording::SMALL_CAMERA };
    let run = |enabled: bool| {
        let mut params = Params::default();
        params.closing.enabled = enabled;
        // Solving for the lens would undo half of it.
        params.mapping.lens_sigma = 0.0;
        let mut agent = Agent::new(camera, Box::new(ThumbnailIndex::default()), params).unwrap();
        let mut closed = Vec::new();
        for (index, shot) in recording.shots.iter().enumerate() {
            let image = shot.image.as_ref().clone();
            let report = agent
                .process(Frame { index: index as u64, timestamp: shot.timestamp, image, color: None })
                .unwrap();
            closed.extend(report.closed_loop);
        }
        closed.extend(agent.finish());
        let map = agent.into_map();
        let positions: Vec<_> = map.trajectory().iter().map(|p| p.world_from_camera.translation).collect();
        let frame = |i: u64| recording.shots[i as usize].world_from_camera.translation;
        let truth: Vec<_> = map.frames.iter().map(|f| frame(f.frame_index)).collect();
        (error(&positions, &truth), closed, map)
    };
    let (open, none, _) = run(false);
    let (closed, loops, map) = run(true);
    assert!(none.is_empty() && !loops.is_empty());
    assert!(open > 0.08 && closed < 0.03, "open {open} m, closed {closed} m");
    assert_eq!(map.edges.iter().filter(|e| e.kind == map::EdgeKind::Loop).count(), loops.len());
}
