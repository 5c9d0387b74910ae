//! A small map for the tests of this crate.

use crate::{
    AgentId, AgentInfo, Color, Edge, EdgeKind, FramePose, Identity, Keyframe, KeyframeId, Luma, Map,
    Observation, Point, Scan, SemiDense, Sensor,
};
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use nalgebra::{SMatrix, SVector, Vector6};
use std::sync::Arc;

/// Numbers that look random and are always the same: xorshift, values in [0, 1).
pub(crate) struct Numbers(u64);

impl Numbers {
    /// A series; another seed gives another one.
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// The next number.
    pub(crate) fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A map of `keyframes` keyframes of 24×18 pixels, five frames each, with every kind of edge.
pub(crate) fn sample_map(keyframes: u32) -> Map {
    random_map(AgentInfo::new("sample", sample_camera()), keyframes, 7)
}

/// The camera of [`sample_map`].
pub(crate) fn sample_camera() -> Pinhole {
    Pinhole { width: 24, height: 18, fx: 20.1, fy: 20.3, cx: 11.4, cy: 8.7 }
}

/// Red, green and blue that the keyframe of [`in_color`] has at a pixel.
pub(crate) fn color_at(id: KeyframeId, x: usize, y: usize) -> [u8; 3] {
    [(90 + 2 * x) as u8, (170 - 3 * y) as u8, (30 + 20 * (id.0 % 10)) as u8]
}

/// Gives the keyframes of some agents images in colour.
pub(crate) fn in_color(map: &mut Map, agents: impl Fn(AgentId) -> bool) {
    let luma = Luma::Rec709;
    for keyframe in map.keyframes.values_mut().filter(|keyframe| agents(keyframe.agent)) {
        let (width, height) = (keyframe.image.width(), keyframe.image.height());
        let pixels = (0..width * height).map(|i| color_at(keyframe.id, i % width, i / width));
        let plane = |value: &dyn Fn([u8; 3]) -> u8| {
            GrayImage::from_vec(width, height, pixels.clone().map(value).collect()).unwrap()
        };
        let weighed =
            |color: [u8; 3]| luma.weights().iter().zip(color).map(|(w, c)| w * f32::from(c)).sum::<f32>();
        let planes = [0, 1].map(|i| plane(&|color| luma.differences(color)[i]));
        keyframe.image = Arc::new(plane(&|color| weighed(color) as u8));
        keyframe.color = Color::of_planes(luma, [&planes[0], &planes[1]]);
    }
}

/// A LiDAR's map of `keyframes` keyframes with scans of a thousand points, five frames each.
pub(crate) fn lidar_map(keyframes: u32) -> Map {
    let mut map =
        Map { edges: Vec::new(), ..random_map(AgentInfo::new("rover", sample_camera()), keyframes, 11) };
    map.agents.values_mut().for_each(|info| info.sensor = Sensor::Lidar);
    let numbers = &mut Numbers::new(12);
    for keyframe in map.keyframes.values_mut() {
        let mut point = || [0, 1, 2].map(|_| 40.0 * numbers.next() as f32 - 20.0);
        let scan = Scan::new((0..1000).map(|_| point()));
        *keyframe = Keyframe {
            image: Arc::new(GrayImage::filled(0, 0, 0)),
            scan: Some(Arc::new(scan)),
            semi_dense: SemiDense::default().into(),
            points: Vec::new(),
            ..keyframe.clone()
        };
        keyframe.world_from_keyframe.scale = 1.0;
    }
    map
}

/// Three agents' maps in one, two of them named alike and one with another camera, joined by two edges and
/// moved.
pub(crate) fn united() -> Map {
    let other = Pinhole { width: 30, height: 20, fx: 25.0, fy: 26.0, cx: 14.4, cy: 9.7 };
    let camera = sample_camera();
    let maps = vec![
        sample_map(3),
        random_map(AgentInfo::new("sample", camera), 2, 8),
        random_map(AgentInfo::new("other", other), 1, 9),
    ];
    let mut map = Map::unite(maps).unwrap();
    let numbers = &mut Numbers::new(3);
    let own = |agent| map.keyframes.values().filter(move |k| k.agent == AgentId(agent)).map(|k| k.id);
    let joins: Vec<_> = own(0).zip(own(1)).collect();
    for (from, to) in joins {
        map.edges.push(Edge { from, to, ..edge(1, EdgeKind::Merge, numbers) });
    }
    let motion = Sim3::exp(&SVector::<f64, 7>::from_fn(|_, _| numbers.next() - 0.5));
    for keyframe in map.keyframes.values_mut().filter(|keyframe| keyframe.agent == AgentId(1)) {
        keyframe.world_from_keyframe = motion * keyframe.world_from_keyframe;
    }
    map.merge_provenance.insert("program".into(), "a test".into());
    map
}

/// An agent's map with numbers of its own, see [`sample_map`].
pub(crate) fn random_map(agent: AgentInfo, keyframes: u32, seed: u64) -> Map {
    let mut numbers = Numbers::new(seed);
    let camera = *agent.camera().expect("an agent with a camera");
    let mut map = Map::of(agent);
    for i in 0..keyframes {
        // Ids with gaps: a map need not hold every keyframe it ever had.
        let id = KeyframeId(3 * i + 1);
        map.keyframes.insert(id, keyframe(id, &camera, &mut numbers));
        map.frames.extend((0..5).map(|k| frame(id, 5 * i + k, &mut numbers)));
    }
    let kinds = [EdgeKind::Odometry, EdgeKind::Covisibility, EdgeKind::Loop, EdgeKind::Merge];
    map.edges = (1..keyframes).map(|i| edge(i, kinds[i as usize % 4], &mut numbers)).collect();
    let provenance = [("source", "a folder with an ümlaut"), ("parameters", "[tracking]\nlevels = 5\n")];
    let agent = map.agents.get_mut(&AgentId::default()).unwrap();
    agent.identity = Some(Identity::random([seed as u8; 16]).later(keyframes));
    agent.provenance = provenance.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    map
}

/// A keyframe with a third of its pixels deep and four points.
fn keyframe(id: KeyframeId, camera: &Pinhole, numbers: &mut Numbers) -> Keyframe {
    let count = camera.width * camera.height;
    let pixels = (0..count).map(|_| (numbers.next() * 256.0) as u8).collect();
    let mut semi_dense = SemiDense::default();
    for pixel in 0..count as u32 {
        if numbers.next() < 0.3 {
            semi_dense.pixel.push(pixel);
            semi_dense.inverse_depth.push(0.2 + numbers.next() as f32);
            semi_dense.variance.push(1e-3 * numbers.next() as f32);
        }
    }
    let tangent = SVector::<f64, 7>::from_fn(|_, _| numbers.next() - 0.5);
    Keyframe {
        id,
        agent: AgentId::default(),
        timestamp: 1_305_031_102.175_304 + f64::from(id.0) / 3.0,
        frame_index: 5 * u64::from(id.0),
        world_from_keyframe: Sim3::exp(&tangent),
        image: Arc::new(GrayImage::from_vec(camera.width, camera.height, pixels).unwrap()),
        color: None,
        scan: None,
        semi_dense: semi_dense.into(),
        points: (0..4).map(|i| point(i, numbers)).collect(),
        // Every other keyframe has some.
        features: (id.0 % 2 == 1).then(|| (0..id.0 as u8 + 3).collect::<Vec<u8>>().into()),
        words: None,
    }
}

/// A point with `observations` observations.
fn point(observations: u32, numbers: &mut Numbers) -> Point {
    let mut number = || numbers.next() as f32;
    let observation = |i| Observation {
        keyframe: KeyframeId(3 * i + 1),
        pixel: [20.0 * number(), 15.0 * number()],
        information: [1.0 + number(), number(), 1.0 + number()],
    };
    let observations = (0..observations).map(observation).collect();
    Point {
        pixel: [20.0 * number(), 15.0 * number()],
        inverse_depth: number(),
        variance: number(),
        observations,
    }
}

/// A frame tracked against `reference`.
fn frame(reference: KeyframeId, index: u32, numbers: &mut Numbers) -> FramePose {
    FramePose {
        timestamp: 1_305_031_102.175_304 + f64::from(index) / 30.0,
        frame_index: u64::from(index),
        reference,
        keyframe_from_frame: Se3::exp(&Vector6::from_fn(|_, _| numbers.next() - 0.5)),
    }
}

/// An edge between the keyframes number `index − 1` and `index`.
fn edge(index: u32, kind: EdgeKind, numbers: &mut Numbers) -> Edge {
    Edge {
        from: KeyframeId(3 * index - 2),
        to: KeyframeId(3 * index + 1),
        from_from_to: Sim3::exp(&SVector::<f64, 7>::from_fn(|_, _| numbers.next() - 0.5)),
        information: SMatrix::from_fn(|_, _| numbers.next()),
        kind,
    }
}
