//! The scene as messages to the page: numbers as JSON, all else as little-endian words that typed arrays read.
//!
//! The first word of a binary message is its kind; `assets/decode.js` reads what is written here.

use super::Message;
use super::page::scene_of;
use crate::report::scene::pose_numbers;
use crate::watch::scene::{Placed, SceneUpdate, Step};
use crate::watch::status::Status;
use crate::watch::{Chunk, Picture};
use serde_json::json;

const KEYFRAMES: u32 = 1;
const TRAJECTORY: u32 = 2;
const CHUNK: u32 = 3;
const PICTURE: u32 = 4;
const EDGES: u32 = 5;

/// An update as messages, in the order in which the page must take them. `level` is up and the mean direction of view.
pub fn messages(update: &SceneUpdate, level: Option<[[f64; 3]; 2]>) -> Vec<Message> {
    let mut out = Vec::new();
    if let Some(agents) = &update.reset {
        out.push(text(&json!({ "kind": "reset", "scene": scene_of(agents) })));
    }
    if let Some([up, forward]) = level {
        out.push(text(&json!({ "kind": "level", "up": up, "forward": forward })));
    }
    if !update.keyframes.is_empty() {
        out.push(binary(keyframes(&update.keyframes)));
    }
    if let Some((from, steps)) = &update.trajectory {
        out.push(binary(trajectory(*from, steps)));
    }
    out.extend(update.edges.iter().map(|all| binary(edges(all))));
    out.extend(update.status.iter().map(|status| text(&status_json(status))));
    out.extend(update.picture.iter().map(|image| picture(image)));
    out.extend(update.chunks.iter().map(|(placed, points)| binary(chunk(placed, points))));
    out
}

fn text(value: &serde_json::Value) -> Message {
    Message::text(value.to_string())
}

fn binary(bytes: Vec<u8>) -> Message {
    Message::binary(bytes)
}

fn status_json(status: &Status) -> serde_json::Value {
    json!({ "kind": "status", "status": status })
}

/// A message that begins with these words.
fn begun(words: &[u32], more: usize) -> Vec<u8> {
    let mut out = Vec::with_capacity(words.len() * 4 + more);
    put(&mut out, words);
    out
}

fn put(out: &mut Vec<u8>, words: &[u32]) {
    words.iter().for_each(|word| out.extend(word.to_le_bytes()));
}

fn put_floats(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|value| out.extend(value.to_le_bytes()));
}

/// `kind, count`; of each `id, agent, frame, scale`, axes and centre: 16 words.
fn keyframes(placed: &[Placed]) -> Vec<u8> {
    let mut out = begun(&[KEYFRAMES, placed.len() as u32], placed.len() * 64);
    for keyframe in placed {
        put(&mut out, &[keyframe.id, keyframe.agent.into(), keyframe.frame_index as u32]);
        put_floats(&mut out, &[keyframe.world_from_keyframe.scale as f32]);
        put_floats(&mut out, &pose_numbers(&keyframe.world_from_keyframe));
    }
    out
}

/// `kind, first step, count`; of each `agent, frame`, seconds as f64, centre, rotation as a quaternion: 11 words.
fn trajectory(from: usize, steps: &[Step]) -> Vec<u8> {
    let mut out = begun(&[TRAJECTORY, from as u32, steps.len() as u32], steps.len() * 44);
    for step in steps {
        put(&mut out, &[step.agent.into(), step.frame_index as u32]);
        out.extend(step.timestamp.to_le_bytes());
        put_floats(&mut out, &step.position);
        put_floats(&mut out, &step.rotation);
    }
    out
}

/// `kind, id, agent, count, width, height, fx, fy, cx, cy`, least and greatest inverse depth; the points,
/// and behind them red, green and blue of each where there are colours.
fn chunk(placed: &Placed, chunk: &Chunk) -> Vec<u8> {
    let camera = &chunk.camera;
    let words = [
        CHUNK,
        placed.id,
        placed.agent.into(),
        chunk.len() as u32,
        camera.width as u32,
        camera.height as u32,
    ];
    let mut out = begun(&words, 24 + chunk.points.len() + chunk.colors.len());
    put_floats(&mut out, &[camera.fx, camera.fy, camera.cx, camera.cy].map(|v| v as f32));
    put_floats(&mut out, &chunk.inverse_depth);
    out.extend_from_slice(&chunk.points);
    out.extend_from_slice(&chunk.colors);
    out
}

/// `kind, frame, width, height, depths`, least and greatest inverse depth; pixels, x and y as u16 each; their codes;
/// intensities.
pub fn picture(picture: &Picture) -> Message {
    let words = [
        PICTURE,
        picture.frame_index as u32,
        picture.width as u32,
        picture.height as u32,
        picture.codes.len() as u32,
    ];
    let mut out = begun(&words, 8 + picture.codes.len() * 5 + picture.grey.len());
    put_floats(&mut out, &picture.range);
    picture.pixels.iter().for_each(|[x, y]| out.extend((u32::from(*y) << 16 | u32::from(*x)).to_le_bytes()));
    out.extend_from_slice(&picture.codes);
    out.extend_from_slice(&picture.grey);
    binary(out)
}

/// `kind, count`; of each `from, to, kind`.
fn edges(edges: &[[u32; 3]]) -> Vec<u8> {
    let mut out = begun(&[EDGES, edges.len() as u32], edges.len() * 12);
    edges.iter().for_each(|edge| put(&mut out, edge));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::scene::tests::scene;
    use crate::watch::{Cursor, POINT_BYTES};

    fn word(bytes: &[u8], index: usize) -> u32 {
        u32::from_le_bytes(bytes[index * 4..][..4].try_into().expect("four bytes"))
    }

    fn float(bytes: &[u8], index: usize) -> f32 {
        f32::from_bits(word(bytes, index))
    }

    #[test]
    fn a_scene_is_described_in_words() {
        let mut scene = scene(2);
        let step = Step {
            frame_index: 9,
            agent: 0,
            timestamp: 1.5,
            position: [1.0, 2.0, 3.0],
            rotation: [0.0, 0.6, 0.0, 0.8],
        };
        scene.set_trajectory(0, [step]);
        scene.set_edges(vec![[1, 0, 2]]);
        let update = scene.update_since(&mut Cursor::default(), usize::MAX);
        let sent: Vec<Message> = messages(&update, Some([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]));
        let texts: Vec<&str> = sent.iter().filter_map(|m| m.to_text().ok().filter(|_| m.is_text())).collect();
        assert!(texts[0].contains("reset") && texts[1].contains("level"), "{texts:?}");
        let binaries: Vec<Vec<u8>> =
            sent.iter().filter(|m| m.is_binary()).map(|m| m.clone().into_data().to_vec()).collect();
        let kinds: Vec<u32> = binaries.iter().map(|b| word(b, 0)).collect();
        assert_eq!(kinds, [KEYFRAMES, TRAJECTORY, EDGES, CHUNK, CHUNK]);
        let [keyframes, trajectory, edges, chunk, _] = &binaries[..] else { panic!("five, as just said") };
        // The second keyframe stands at x = 1.
        assert_eq!((word(keyframes, 1), word(keyframes, 2 + 16)), (2, 1));
        assert_eq!(float(keyframes, 2 + 16 + 4 + 9), 1.0);
        assert_eq!((word(trajectory, 4), float(trajectory, 9), float(trajectory, 11)), (9, 3.0, 0.6));
        assert_eq!(trajectory[20..28], 1.5f64.to_le_bytes());
        assert_eq!((word(edges, 2), word(edges, 4)), (1, 2));
        assert_eq!(chunk.len(), 12 * 4 + word(chunk, 3) as usize * POINT_BYTES);
        assert_eq!((word(chunk, 1), word(chunk, 4)), (1, 100));
    }
}
