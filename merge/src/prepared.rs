//! What merging needs of a map: its keyframes, each made ready once, when first asked for.

use crate::key_points::{DepthGrid, KeyPointParams, measure};
use crate::overlap::Glimpse;
use crate::scale_filter::MeasuredPoint;
use backend::sim3_align::KeyframeView;
use geometry::sensor::Rectification;
use geometry::{Pinhole, Pyramid, Sim3};
use map::{AgentId, Keyframe, KeyframeId, Map, SemiDense, rectified_depths};
use nalgebra::Vector3;
use place_recog::KeyframeFeatures;
use place_recog::features::Features;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

/// Pyramid levels prepared for direct alignment.
const LEVELS: usize = 5;
/// Bytes of what direct alignment takes, for each pixel: image and depth with their halvings, about.
const VIEW_BYTES: usize = 13;

/// A map with the features of its keyframes.
pub struct PreparedMap<'a> {
    map: &'a Map,
    features: &'a KeyframeFeatures,
    params: &'a KeyPointParams,
    /// The keyframes in order of time.
    order: Vec<KeyframeId>,
    /// Those of each agent, in order of time.
    own: BTreeMap<AgentId, Vec<KeyframeId>>,
    /// Where each is among its agent's.
    position: BTreeMap<KeyframeId, (AgentId, usize)>,
    /// What they see, made when first asked for.
    glimpses: OnceLock<Vec<Glimpse<'a>>>,
    keyframes: BTreeMap<KeyframeId, OnceLock<PreparedKeyframe<'a>>>,
}

/// A keyframe with its features, the 3-D points at them, and its pyramid.
pub struct PreparedKeyframe<'a> {
    /// The keyframe.
    pub keyframe: &'a Keyframe,
    /// Its camera.
    pub camera: &'a Pinhole,
    /// Its features, where that camera would have found them.
    pub features: Arc<Features>,
    rectification: Option<Rectification>,
    params: &'a KeyPointParams,
    // Each made when first asked for: most places need no more than bearings, further closures no more than a view.
    bearings: OnceLock<Vec<Vector3<f64>>>,
    depth: OnceLock<Cow<'a, SemiDense>>,
    points: OnceLock<Vec<Option<MeasuredPoint>>>,
    view: OnceLock<KeyframeView>,
}

impl<'a> PreparedMap<'a> {
    /// Takes the keyframes of `map` that have features and depth. The latest ones of an agent that is under way have no
    /// depth yet: nothing could tell their scale.
    pub fn new(map: &'a Map, features: &'a KeyframeFeatures, params: &'a KeyPointParams) -> Self {
        let usable = |keyframe: &&Keyframe| features.contains(keyframe.id) && !keyframe.semi_dense.is_empty();
        let mut order: Vec<KeyframeId> =
            map.keyframes.values().filter(usable).map(|keyframe| keyframe.id).collect();
        order
            .sort_by(|a, b| map.keyframes[a].timestamp.total_cmp(&map.keyframes[b].timestamp).then(a.cmp(b)));
        let keyframes = order.iter().map(|&id| (id, OnceLock::new())).collect();
        let (mut own, mut position) = (BTreeMap::<AgentId, Vec<KeyframeId>>::new(), BTreeMap::new());
        for &id in &order {
            let agent = map.keyframes[&id].agent;
            let of_agent = own.entry(agent).or_default();
            position.insert(id, (agent, of_agent.len()));
            of_agent.push(id);
        }
        Self { map, features, params, order, own, position, glimpses: OnceLock::new(), keyframes }
    }

    /// The map.
    pub fn map(&self) -> &'a Map {
        self.map
    }

    /// The keyframes that have features and depth, in order of time.
    pub fn order(&self) -> &[KeyframeId] {
        &self.order
    }

    /// The keyframe, made ready; `None` when it is not in the map, or has no features or no
    /// depth.
    pub fn get(&self, id: KeyframeId) -> Option<&PreparedKeyframe<'a>> {
        let slot = self.keyframes.get(&id)?;
        let keyframe = self.map.keyframes.get(&id)?;
        let features = self.features.get(id)?;
        Some(slot.get_or_init(|| PreparedKeyframe::new(keyframe, self.map, features, self.params)))
    }

    /// Whether the keyframe is in the map, with features and depth.
    pub fn has(&self, id: KeyframeId) -> bool {
        self.keyframes.contains_key(&id)
    }

    /// What the keyframes made ready take with all features that were read, bytes, about.
    pub fn bytes(&self) -> usize {
        let ready = self.keyframes.values().filter_map(|slot| slot.get());
        self.features.bytes() + ready.map(PreparedKeyframe::bytes).sum::<usize>()
    }

    /// Gives back the memory of the keyframes made ready and of their features: they are made ready again when asked for.
    pub fn forget(&mut self) {
        self.keyframes.values_mut().for_each(|slot| drop(slot.take()));
        self.features.rest();
    }

    /// The keyframes before and after `id` in order of time, of the same agent.
    pub fn neighbours(&self, id: KeyframeId) -> (Option<KeyframeId>, Option<KeyframeId>) {
        let Some((own, position)) = self.among_its_own(id) else { return (None, None) };
        let before = position.checked_sub(1).map(|before| own[before]);
        (before, own.get(position + 1).copied())
    }

    /// The keyframes of the agent whose keyframe this is, in order of time, and where it is among them.
    fn among_its_own(&self, id: KeyframeId) -> Option<(&[KeyframeId], usize)> {
        let (agent, position) = *self.position.get(&id)?;
        Some((self.own.get(&agent)?, position))
    }

    /// The keyframe with up to `radius` before and after it in order of time, of the same agent.
    pub fn around(&self, id: KeyframeId, radius: usize) -> Vec<KeyframeId> {
        let Some((own, position)) = self.among_its_own(id) else { return Vec::new() };
        own[position.saturating_sub(radius)..(position + radius + 1).min(own.len())].to_vec()
    }

    /// What the keyframes see, in order of time; those without depth are left out.
    pub(crate) fn glimpses(&self) -> &[Glimpse<'a>] {
        let glimpse = |id: &KeyframeId| {
            let glimpse = Glimpse::of(self.map, *id);
            // All keyframes are looked at, of which few are needed further.
            self.map.keyframes.get(id).into_iter().for_each(Keyframe::rest);
            glimpse
        };
        self.glimpses.get_or_init(|| self.order.iter().filter_map(glimpse).collect())
    }

    /// World pose of a keyframe of the map.
    pub fn world_from(&self, id: KeyframeId) -> Option<Sim3> {
        Some(self.map.keyframes.get(&id)?.world_from_keyframe)
    }
}

impl<'a> PreparedKeyframe<'a> {
    fn new(
        keyframe: &'a Keyframe,
        map: &'a Map,
        mut features: Arc<Features>,
        params: &'a KeyPointParams,
    ) -> Self {
        let camera = map.camera(keyframe);
        let rectification = map.rectification(keyframe);
        if let Some(rectification) = &rectification {
            for keypoint in &mut Arc::make_mut(&mut features).keypoints {
                keypoint.pixel = rectification.pixel(keypoint.pixel);
            }
        }
        let (bearings, depth, points, view) =
            (OnceLock::new(), OnceLock::new(), OnceLock::new(), OnceLock::new());
        Self { keyframe, camera, features, rectification, params, bearings, depth, points, view }
    }

    /// What it takes beside its features, bytes, about.
    fn bytes(&self) -> usize {
        let bearings = self.bearings.get().map_or(0, |bearings| size_of_val(&bearings[..]));
        let points = self.points.get().map_or(0, |points| size_of_val(&points[..]));
        let view = self.view.get().map_or(0, |_| VIEW_BYTES * self.camera.width * self.camera.height);
        bearings + points + view
    }

    /// Its depth, where an ideal camera sees it.
    pub fn depth(&self) -> &SemiDense {
        self.depth.get_or_init(|| {
            let depth = &*self.keyframe.semi_dense;
            self.rectification
                .as_ref()
                .map_or(Cow::Borrowed(depth), |by| Cow::Owned(rectified_depths(depth, self.camera, by)))
        })
    }

    fn pixels(&self) -> impl Iterator<Item = [f32; 2]> {
        self.features.keypoints.iter().map(|keypoint| keypoint.pixel)
    }

    /// Directions of the features' rays in the camera frame, length 1.
    pub fn bearings(&self) -> &[Vector3<f64>] {
        let ray = |[x, y]: [f32; 2]| self.camera.unproject(f64::from(x), f64::from(y)).normalize();
        self.bearings.get_or_init(|| self.pixels().map(ray).collect())
    }

    /// The 3-D points of the features, in the keyframe's camera frame and unit, where there is depth.
    pub fn points(&self) -> &[Option<MeasuredPoint>] {
        self.points.get_or_init(|| {
            let depth = DepthGrid::new(self.depth(), self.camera);
            self.pixels().map(|pixel| measure(pixel, &depth, self.camera, self.params)).collect()
        })
    }

    /// The keyframe as direct alignment takes it: as an ideal camera would have taken it.
    pub fn view(&self) -> &KeyframeView {
        self.view.get_or_init(|| {
            let image = &*self.keyframe.image;
            let image = self.rectification.as_ref().map_or_else(|| image.clone(), |by| by.image(image));
            KeyframeView::new(&Pyramid::new(image, LEVELS), self.depth(), self.camera)
        })
    }
}
