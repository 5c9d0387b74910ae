//! What images show beside a still scene: bars that move with the camera, nothing at all, other light.

use super::*;

/// Bars above and below, and letters in a row.
fn with_bars_and_letters(_: usize, image: &GrayImage) -> GrayImage {
    let mut altered = image.clone();
    let (width, height) = (image.width(), image.height());
    for y in 0..height {
        for x in 0..width {
            let is_bar = y < height / 8 || y >= height - height / 8;
            let is_letter =
                (0.7..0.8).contains(&(y as f32 / height as f32)) && x % 16 < 10 && (x / 16 + y / 7) % 3 > 0;
            match (is_bar, is_letter) {
                (true, _) => altered.set(x, y, 0),
                (_, true) => altered.set(x, y, 250),
                _ => {}
            }
        }
    }
    altered
}

#[test]
fn what_moves_with_the_camera_does_not_say_that_it_stands() {
    for lag in [0, 3] {
        let mut agent = agent_with_lag(lag);
        feed(&mut agent, with_bars_and_letters);
        agent.finish();
        let map = agent.map();
        let frames: Vec<u64> = map.frames.iter().map(|frame| frame.frame_index).collect();
        assert!(10 * frames.len() >= 9 * drive().shots.len(), "{frames:?}");
        let error = trajectory_error(map);
        assert!(error < 0.01 * drive().path_length(), "off by {error} m, lag {lag}");
    }
}

#[test]
fn what_moves_with_a_camera_that_turns_gets_neither_points_nor_depth() {
    let camera = Recording::SMALL_CAMERA;
    let walk = Recording::render(yard(), camera, &trajectory::walk(90, 30.0, 5), 30.0);
    let mut agent = agent();
    for (i, shot) in walk.shots.iter().enumerate() {
        let (index, timestamp) = (i as u64, shot.timestamp);
        let image = with_bars_and_letters(i, &shot.image);
        agent.process(Frame { index, timestamp, image, color: None }).unwrap();
    }
    agent.finish();
    let edges = [camera.height / 8, camera.height - camera.height / 8];
    let on_edge = |y: f32| edges.iter().any(|edge| (y - *edge as f32).abs() < 2.0);
    let (mut points, mut depths) = (0, 0);
    for keyframe in agent.map().keyframes.values() {
        points += keyframe.points.iter().filter(|point| on_edge(point.pixel[1])).count();
        let rows = keyframe.semi_dense.iter().map(|depth| (depth.0 / camera.width as u32) as f32);
        depths += rows.filter(|row| on_edge(*row)).count();
    }
    // Without the mask 82 points and 801 depths.
    assert!(points < 8 && depths < 80, "{points} points and {depths} depths");
    assert!(agent.map().frames.len() >= 80, "{} frames", agent.map().frames.len());
}

#[test]
fn a_map_whose_first_keyframes_found_no_depth_is_begun_again() {
    let mut agent = agent();
    let mut begun = Vec::new();
    for (i, shot) in drive().shots.iter().enumerate() {
        if begun.is_empty() && agent.view.keyframes.len() >= 4 {
            // As if its poses were wrong.
            agent.map_quality = MapQuality::Broken;
        }
        let image = shot.image.as_ref().clone();
        let report =
            agent.process(Frame { index: i as u64, timestamp: shot.timestamp, image, color: None }).unwrap();
        begun.extend((report.reason == Some("its first keyframes found no depth")).then_some(i));
    }
    assert!(matches!(begun[..], [frame] if frame > 5), "{begun:?}");
    agent.finish();
    let map = agent.map();
    assert_eq!(map.keyframes.keys().next(), Some(&KeyframeId(0)));
    // 43 of 50: the first have left the view by then.
    assert!(5 * map.frames.len() >= 4 * drive().shots.len(), "{} frames", map.frames.len());
    let error = trajectory_error(map);
    assert!(error < 0.01 * drive().path_length(), "off by {error} m");
}

#[test]
fn changing_light_is_followed() {
    let mut agent = agent();
    let reports = feed(&mut agent, |i, image| {
        crate::test_scene::brightened(
            image,
            0.8 + 0.2 * (0.3 * i as f32).sin(),
            5.0 * (0.2 * i as f32).cos() + 6.0,
        )
    });
    let begun = reports.iter().position(|r| r.state == TrackingState::Tracking).expect("a first map");
    assert!(reports[begun..].iter().all(|r| r.state == TrackingState::Tracking));
    agent.finish();
    let error = trajectory_error(agent.map());
    assert!(error < 0.02 * drive().path_length(), "off by {error} m");
}
