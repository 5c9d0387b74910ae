//! Small maps, and a network of which every fault is drawn from a seed.

use crate::keys::Peer;
use crate::node::{Action, Config, Event, LinkId, Node, Notice, Quota, part_of};
use crate::publishing::Publisher;
use crate::store::{MemoryStore, Store};
use crate::wire::{Message, Role, VERSIONS};
pub use geometry::Random;
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use map::{
    AgentId, AgentInfo, Color, Edge, EdgeKind, FramePose, Identity, Keyframe, KeyframeId, Luma, Map,
    Observation, Point, Scan, SemiDense, Sensor, Uuid,
};
use nalgebra::{SMatrix, SVector, Vector6};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

pub fn agent(number: u128) -> Identity {
    Identity { uuid: Uuid::from_u128(number), epoch: 0 }
}

/// A map of so many keyframes of 160×120 pixels, about 30 kB each.
pub fn map(identity: Identity, keyframes: u32) -> Map {
    let camera = Pinhole { width: 160, height: 120, fx: 140.0, fy: 141.0, cx: 79.4, cy: 59.7 };
    let info = AgentInfo { identity: Some(identity), ..AgentInfo::new("tester", camera) };
    let mut numbers = Random::new(identity.uuid.as_u128() as u64);
    let mut map = Map::of(info);
    for i in 0..keyframes {
        grow(&mut map, i, &mut numbers);
    }
    map
}

/// A LiDAR's map of so many keyframes of 500 points, about 3 kB each.
pub fn lidar_map(identity: Identity, keyframes: u32) -> Map {
    let mut map = map(identity, keyframes);
    let mut numbers = Random::new(identity.uuid.as_u128() as u64);
    map.agents.values_mut().for_each(|info| info.sensor = Sensor::Lidar);
    for keyframe in map.keyframes.values_mut() {
        let points = (0..500).map(|_| [0, 1, 2].map(|_| 20.0 * numbers.unit() as f32 - 10.0));
        keyframe.scan = Some(Arc::new(Scan::new(points)));
        keyframe.image = Arc::new(GrayImage::filled(0, 0, 0));
        keyframe.world_from_keyframe.scale = 1.0;
        (keyframe.semi_dense, keyframe.points) = Default::default();
        (keyframe.features, keyframe.color) = (None, None);
    }
    map
}

fn grow(map: &mut Map, i: u32, numbers: &mut Random) {
    let id = KeyframeId(2 * i + 1);
    let pixels = (0..160 * 120).map(|_| (numbers.unit() * 256.0) as u8).collect();
    let mut semi_dense = SemiDense::default();
    for pixel in (0..160 * 120).step_by(13) {
        semi_dense.pixel.push(pixel);
        semi_dense.inverse_depth.push(0.1 + numbers.unit() as f32);
        semi_dense.variance.push(1e-3 * numbers.unit() as f32);
    }
    let observation = |numbers: &mut Random| Observation {
        keyframe: KeyframeId(2 * (i / 2) + 1),
        pixel: [numbers.unit() as f32, 3.0],
        information: [1.0, 0.0, 1.0],
    };
    let points = (0..5).map(|_| Point {
        pixel: [numbers.unit() as f32 * 100.0, 7.0],
        inverse_depth: 0.5,
        variance: 0.1,
        observations: vec![observation(numbers)],
    });
    let points = points.collect();
    let keyframe = Keyframe {
        id,
        agent: AgentId::default(),
        timestamp: f64::from(i) / 3.0,
        frame_index: u64::from(10 * i),
        world_from_keyframe: Sim3::exp(&SVector::<f64, 7>::from_fn(|_, _| numbers.unit() - 0.5)),
        image: Arc::new(GrayImage::from_vec(160, 120, pixels).unwrap()),
        // Some have colours, which nothing looks into here.
        color: (i % 3 == 1).then(|| Color { luma: Luma::Rec601, jpeg: [i as u8; 40].into() }),
        scan: None,
        semi_dense: semi_dense.into(),
        points,
        features: Some((0..3000).map(|k| (k * 7 + i) as u8).collect::<Vec<u8>>().into()),
        words: None,
    };
    map.keyframes.insert(id, keyframe);
    map.frames.extend((0..10).map(|k| FramePose {
        timestamp: f64::from(i) / 3.0 + f64::from(k) / 30.0,
        frame_index: u64::from(10 * i + k),
        reference: id,
        keyframe_from_frame: Se3::exp(&Vector6::from_fn(|_, _| numbers.unit() - 0.5)),
    }));
    if i > 0 {
        map.edges.push(Edge {
            from: KeyframeId(2 * i - 1),
            to: id,
            from_from_to: Sim3::exp(&SVector::<f64, 7>::from_fn(|_, _| numbers.unit() - 0.5)),
            information: SMatrix::from_fn(|_, _| numbers.unit()),
            kind: EdgeKind::Odometry,
        });
    }
}

/// What goes wrong on a network.
#[derive(Clone, Copy, Debug)]
pub struct Faults {
    /// Share of messages that are lost.
    pub loss: f64,
    /// Share of messages that come twice.
    pub twice: f64,
    /// How long a message is under way, at the least and at the most: it may be overtaken.
    pub delay: [Duration; 2],
    /// Bytes a second that a direction of a link carries.
    pub rate: f64,
}

impl Faults {
    /// A network that does what it should, at 100 Mbit/s.
    pub const NONE: Self =
        Self { loss: 0.0, twice: 0.0, delay: [Duration::from_micros(500); 2], rate: 12.5e6 };
}

/// Nodes on a network, each linked with each as long as no partition is between them.
pub struct Network {
    pub now: Duration,
    pub nodes: Vec<Node>,
    pub stores: Vec<Arc<dyn Store>>,
    pub faults: Faults,
    /// From whom to whom nothing comes.
    pub cut: Vec<(usize, usize)>,
    /// From when until when no link carries anything: what is sent then comes afterwards, in its order.
    pub still: Option<[Duration; 2]>,
    pub notices: Vec<Vec<Notice>>,
    /// Bytes of parts of objects that were sent.
    pub parts_sent: u64,
    /// All bytes that were sent.
    pub sent: u64,
    pub closed: usize,
    /// The longest that a message waited for the link to be free.
    pub waited: Duration,
    /// Whose each node is, where peers have keys.
    pub peers: Vec<Peer>,
    /// Whether disks take no time.
    pub settles: bool,
    /// Who looks at nothing, until when, and what came meanwhile.
    stalled: Option<(usize, Duration, Vec<Event>)>,
    numbers: Random,
    links: BTreeMap<LinkId, [usize; 2]>,
    next_link: LinkId,
    reopen: Vec<(Duration, [usize; 2])>,
    free: BTreeMap<(LinkId, usize), Duration>,
    in_transit: BTreeMap<(Duration, u64), (LinkId, usize, Vec<u8>)>,
    sequence: u64,
    ticked: Duration,
}

pub fn config(number: usize, role: Role) -> Config {
    let node = Uuid::from_u128(1000 + number as u128);
    let name = format!("node {number}");
    let (quota, versions) = (Quota::default(), VERSIONS);
    Config { node, role, name, quota, waits: false, versions, signer: None }
}

const TICK: Duration = Duration::from_millis(50);

impl Network {
    /// So many nodes that know nothing.
    pub fn new(count: usize, seed: u64, faults: Faults) -> Self {
        let stores = (0..count).map(|_| Arc::new(MemoryStore::default()) as Arc<dyn Store>);
        Self::with_stores(stores.collect(), seed, faults)
    }

    pub fn with_stores(stores: Vec<Arc<dyn Store>>, seed: u64, faults: Faults) -> Self {
        let nodes = stores.iter().enumerate().map(|(i, store)| {
            let role = if i == 0 { Role::Station } else { Role::Agent };
            Node::new(config(i, role), Arc::clone(store))
        });
        let nodes: Vec<Node> = nodes.collect();
        let count = nodes.len();
        let pairs = (1..count).flat_map(|b| (0..b).map(move |a| [a, b]));
        let reopen = pairs.map(|pair| (Duration::ZERO, pair)).collect();
        Self {
            now: Duration::ZERO,
            notices: nodes.iter().map(|_| Vec::new()).collect(),
            nodes,
            stores,
            faults,
            cut: Vec::new(),
            still: None,
            parts_sent: 0,
            sent: 0,
            closed: 0,
            waited: Duration::ZERO,
            peers: Vec::new(),
            settles: true,
            stalled: None,
            numbers: Random::new(seed),
            links: BTreeMap::new(),
            next_link: 1,
            reopen,
            free: BTreeMap::new(),
            in_transit: BTreeMap::new(),
            sequence: 0,
            ticked: Duration::ZERO,
        }
    }

    /// Tells a version of a map.
    pub fn publish(&mut self, node: usize, publisher: &mut Publisher, map: &Map, finished: bool) {
        if let Some(publication) = publisher.publish(map, finished).unwrap() {
            self.event(node, Event::Publish(Box::new(publication)));
        }
    }

    /// A node looks at nothing for so long: what comes meanwhile waits.
    pub fn stall(&mut self, node: usize, time: Duration) {
        self.stalled = Some((node, self.now + time, Vec::new()));
    }

    pub fn event(&mut self, node: usize, event: Event) {
        match &mut self.stalled {
            Some((stalled, until, waiting)) if *stalled == node && self.now < *until => {
                return waiting.extend(Some(event).filter(|event| !matches!(event, Event::Tick)));
            }
            Some((stalled, ..)) if *stalled == node => {
                let (_, _, waiting) = self.stalled.take().unwrap();
                waiting.into_iter().for_each(|event| self.event(node, event));
            }
            _ => {}
        }
        let actions = self.nodes[node].handle(self.now, event);
        for action in actions {
            match action {
                Action::Send { link, bytes, .. } => self.send(node, link, bytes),
                Action::Serve { link, hash, offset, length } => {
                    let message = match self.stores[node].get(&hash) {
                        Some(bytes) => Message::Part { hash, offset, bytes: part_of(&bytes, offset, length) },
                        None => Message::Missing { hash },
                    };
                    self.send(node, link, message.to_bytes());
                }
                Action::Close { link, .. } => self.end(node, link),
                Action::Notify(notice) => self.notices[node].push(notice),
            }
        }
        if self.settles {
            self.stores[node].wait_until_written();
        }
    }

    /// A message as if `node` had sent it to all its neighbours.
    pub fn forge(&mut self, node: usize, bytes: &[u8]) {
        let links: Vec<LinkId> =
            self.links.iter().filter(|(_, ends)| ends.contains(&node)).map(|(link, _)| *link).collect();
        links.into_iter().for_each(|link| self.send(node, link, bytes.to_vec()));
    }

    fn send(&mut self, from: usize, link: LinkId, bytes: Vec<u8>) {
        let Some(&[a, b]) = self.links.get(&link) else { return };
        let to = if from == a { b } else { a };
        if let Ok(Message::Part { bytes, .. }) = Message::from_bytes(&bytes) {
            self.parts_sent += bytes.len() as u64;
        }
        self.sent += bytes.len() as u64;
        let free = self.free.entry((link, to)).or_default();
        let begin = self.now.max(*free);
        let begin = self.still.filter(|[from, to]| (*from..*to).contains(&begin)).map_or(begin, |[_, to]| to);
        self.waited = self.waited.max(begin - self.now);
        *free = begin + Duration::from_secs_f64(bytes.len() as f64 / self.faults.rate);
        let there = *free;
        let copies = 1 + usize::from(self.numbers.unit() < self.faults.twice);
        for _ in 0..copies {
            if self.numbers.unit() < self.faults.loss || self.cut.contains(&(from, to)) {
                continue;
            }
            let [least, most] = self.faults.delay;
            let at = there + least + (most - least).mul_f64(self.numbers.unit());
            self.sequence += 1;
            self.in_transit.insert((at, self.sequence), (link, to, bytes.clone()));
        }
    }

    /// A node closes a link: the other end learns it after what was sent before.
    fn end(&mut self, node: usize, link: LinkId) {
        let Some(&[a, b]) = self.links.get(&link) else { return };
        let to = if node == a { b } else { a };
        let free = self.free.get(&(link, to)).copied().unwrap_or_default().max(self.now);
        self.sequence += 1;
        self.in_transit.insert((free + self.faults.delay[1], self.sequence), (link, to, Vec::new()));
    }

    /// A link ends, for both.
    fn close(&mut self, link: LinkId, by: Option<usize>) {
        let Some(ends) = self.links.remove(&link) else { return };
        self.closed += 1;
        self.reopen.push((self.now + Duration::from_secs(1), ends));
        for end in ends {
            if Some(end) != by {
                self.event(end, Event::Down { link });
            }
        }
    }

    /// A node is killed and started again with what its store holds.
    pub fn restart(&mut self, node: usize) {
        let role = if node == 0 { Role::Station } else { Role::Agent };
        self.nodes[node] = Node::new(config(node, role), Arc::clone(&self.stores[node]));
        let links: Vec<LinkId> =
            self.links.iter().filter(|(_, ends)| ends.contains(&node)).map(|(link, _)| *link).collect();
        links.into_iter().for_each(|link| self.close(link, Some(node)));
    }

    /// Lets time pass until `done`, but no longer than to `end`; whether it was.
    pub fn run_until(&mut self, end: Duration, mut done: impl FnMut(&Self) -> bool) -> bool {
        while self.now < end {
            if done(self) {
                return true;
            }
            self.open_links();
            let next = self.in_transit.first_key_value().map_or(Duration::MAX, |((at, _), _)| *at);
            if next < self.ticked + TICK {
                self.now = self.now.max(next);
                match self.in_transit.pop_first() {
                    Some((_, (link, to, bytes))) if self.links.contains_key(&link) => {
                        if bytes.is_empty() {
                            let [a, b] = self.links[&link];
                            self.close(link, Some(if to == a { b } else { a }));
                        } else {
                            self.event(to, Event::Received { link, bytes });
                        }
                    }
                    _ => {}
                }
                continue;
            }
            self.ticked += TICK;
            self.now = self.now.max(self.ticked);
            for node in 0..self.nodes.len() {
                self.event(node, Event::Tick);
            }
        }
        done(self)
    }

    fn open_links(&mut self) {
        let now = self.now;
        let cut = &self.cut;
        let can = |[a, b]: &[usize; 2]| !cut.contains(&(*a, *b)) && !cut.contains(&(*b, *a));
        let due: Vec<_> = self.reopen.extract_if(.., |(at, ends)| *at <= now && can(ends)).collect();
        for (_, ends) in due {
            let link = self.next_link;
            self.next_link += 1;
            self.links.insert(link, ends);
            for end in ends {
                let other = if end == ends[0] { ends[1] } else { ends[0] };
                let peer = self.peers.get(other).cloned();
                self.event(end, Event::Up { link, address: format!("link {link}"), peer });
            }
        }
    }

    /// The map of an agent as a node has it, if it is whole there.
    pub fn whole(&self, node: usize, agent: Identity) -> Option<Map> {
        let snapshot =
            self.nodes[node].snapshots().find(|snapshot| snapshot.agent == agent && snapshot.missing == 0)?;
        let mut assembler = crate::assembling::Assembler::default();
        let made = assembler.assemble(agent, &snapshot.entries, &*self.stores[node], None).unwrap()?;
        made.whole.then_some(made.map)
    }

    /// What was told of trouble.
    pub fn trouble(&self, node: usize) -> Vec<String> {
        let trouble = self.notices[node].iter().filter_map(|notice| match notice {
            Notice::Trouble(text) => Some(text.clone()),
            _ => None,
        });
        trouble.collect()
    }
}
