//! A first map that nothing fits is given up for a better one.

use geometry::Pinhole;
use loopbox_tests::{World, render, trajectory};
use slam_direct::{Agent, Frame, Params, TrackingState};

const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 210.0, fy: 210.0, cx: 159.5, cy: 119.5 };

/// Shows the agent a few frames of one world, then another: a cut right after the start.
#[test]
fn a_young_map_that_fits_nothing_is_replaced() {
    let places = Box::new(place_recog::ThumbnailIndex::default());
    let mut agent = Agent::new(CAMERA, places, Params::default()).unwrap();
    let path = trajectory::sideways(70, 3.5);
    let (before, after) = (World::yard(1), World::yard(2));
    let mut states = Vec::new();
    for (index, &world_from_camera) in path.iter().enumerate() {
        let world = if index < 8 { &before } else { &after };
        // The second shot is taken upside down, so that it shares nothing with the first.
        let turned =
            geometry::Se3::exp(&nalgebra::Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, std::f64::consts::PI));
        let pose = if index < 8 { world_from_camera } else { world_from_camera * turned };
        let (image, _) = render(world, &CAMERA, &pose);
        states.push(
            agent
                .process(Frame { index: index as u64, timestamp: index as f64 / 15.0, image, color: None })
                .unwrap()
                .state,
        );
    }
    agent.finish();
    assert!(states[..8].contains(&TrackingState::Tracking), "the first shot starts a map: {states:?}");
    assert!(states.contains(&TrackingState::Lost), "the cut loses it");
    assert_eq!(states.last(), Some(&TrackingState::Tracking), "the second shot is tracked: {states:?}");
    let first = agent.map().frames.first().map(|f| f.frame_index);
    assert!(first.is_some_and(|f| f >= 8), "the useless map is gone, but frame {first:?} is left");
}
