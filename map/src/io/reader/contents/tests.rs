use super::*;
use crate::test_support::{Numbers, sample_map};

/// Messages behind a right checksum may still be nonsense: whatever they hold, loading says yes
/// or no.
#[test]
fn changed_messages_never_panic() {
    let map = sample_map(2);
    let keyframe = map.keyframes.values().next().unwrap();
    let image = views::image(keyframe, picture::encode_png(&keyframe.image).unwrap()).encode_to_vec();
    let depth = convert::keyframe_to_message(keyframe, None).encode_to_vec();
    let mut graph = GraphMessage::default();
    map.edges.iter().for_each(|edge| convert::push_edge(&mut graph, edge));
    map.frames.iter().for_each(|frame| convert::push_frame(&mut graph, frame));
    let graph = graph.encode_to_vec();
    let features = FeaturesMessage { keyframe: 1, data: vec![7; 40], words: Vec::new() }.encode_to_vec();
    let mut numbers = Numbers::new(5);
    let mut below = |limit: usize| (numbers.next() * limit as f64) as usize;
    let mut outcomes = [0, 0];
    for round in 0..3000 {
        let mut messages = [image.clone(), depth.clone(), graph.clone(), features.clone()];
        let changed = &mut messages[round % 4];
        for _ in 0..=below(3) {
            let at = below(changed.len());
            changed[at] = below(256) as u8;
        }
        if below(4) == 0 {
            changed.truncate(below(changed.len()));
        }
        let mut contents = Contents { about: About::of(&map), ..Default::default() };
        let taken = contents
            .image(&messages[0])
            .and_then(|()| contents.keyframe(&messages[1]))
            .and_then(|()| contents.graph(&messages[2]))
            .and_then(|()| contents.features(&messages[3]));
        let loaded = taken.map_err(Refusal::from).and_then(|()| contents.into_map());
        outcomes[usize::from(loaded.is_ok())] += 1;
    }
    assert!(outcomes[0] > 300 && outcomes[1] > 300, "{outcomes:?}");
}
