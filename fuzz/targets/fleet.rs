//! What neighbours of the fleet send: messages, lists, parts of maps, what they found out, and certificates. What is read is written and read again as it was.
#![no_main]

use fleet::keys::Peer;
use fleet::lossy_codec::{depth, digest::Digest, image};
use fleet::manifest::{Manifest, page_from_bytes, page_to_bytes};
use fleet::merge_results::MergeResults;
use fleet::wire::Message;
use geometry::{GrayImage, Pinhole};
use map::parts::{
    agent_from_bytes, depth_from_bytes, graph_from_bytes, image_from_bytes, scan_from_bytes, scan_to_bytes,
    time_from_bytes,
};
use map::{AgentInfo, KeyframeId, Scan, Sensor};
use place_recog::Vocabulary;
use std::sync::Arc;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    let camera = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
    match kind % 14 {
        0 => {
            if let Ok(message) = Message::from_bytes(bytes) {
                assert_eq!(message.to_bytes(), bytes);
            }
        }
        1 => {
            if let Ok(manifest) = Manifest::from_bytes(bytes) {
                assert_eq!(manifest.to_bytes(), bytes);
            }
        }
        2 => {
            if let Ok(entries) = page_from_bytes(bytes) {
                assert_eq!(page_to_bytes(&entries), bytes);
            }
        }
        3 => drop(agent_from_bytes(bytes)),
        4 => drop(image_from_bytes(bytes, &camera)),
        5 => {
            let image = Arc::new(GrayImage::filled(8, 6, 7));
            drop(depth_from_bytes(bytes, image, &AgentInfo::new("one", camera)));
        }
        6 => drop(graph_from_bytes(bytes)),
        7 => drop(image::decode(bytes, &camera)),
        8 => {
            if let Ok(read) = depth::decode(bytes, &camera) {
                assert_eq!(depth::decode(&depth::encode(&read, &camera), &camera).as_ref(), Ok(&read));
            }
        }
        9 => drop(Peer::of_certificate(bytes)),
        10 => {
            if let Ok((id, scan)) = scan_from_bytes(bytes) {
                assert_eq!(scan_from_bytes(&scan_to_bytes(id, &scan)), Ok((id, scan)));
            }
        }
        11 => drop(time_from_bytes(bytes, Arc::new(Scan::default()), &AgentInfo::new("one", Sensor::Lidar))),
        12 => check_results(bytes),
        _ => {
            let (id, vocabulary) = (KeyframeId(9), Vocabulary::shipped());
            if let Ok(read) = Digest::from_bytes(bytes, id, &vocabulary) {
                assert_eq!(Digest::from_bytes(&read.to_bytes(id), id, &vocabulary), Ok(read));
            }
        }
    }
});

/// What a neighbour found out, put beside other things and told on.
fn check_results(bytes: &[u8]) {
    let Ok(found) = MergeResults::from_bytes(bytes) else { return };
    let again =
        MergeResults::from_bytes(&found.to_bytes()).map(|again| (again.agents.len(), again.pair_verdicts));
    assert_eq!(again, Ok((found.agents.len(), found.pair_verdicts.clone())));
    let all = found.clone().overlaid_by(&MergeResults::default());
    assert!(all.agents.len() <= found.agents.len() && all.accepted() == found.accepted());
    for agent in &found.agents {
        let _ = found.is_joined(&agent.agent);
    }
    let pair = [String::new(), String::new()];
    assert_eq!(found.has_decided(&pair), found.overlaid_by(&all).has_decided(&pair));
}
