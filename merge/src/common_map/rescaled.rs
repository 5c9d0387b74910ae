//! Closures of agents whose keyframes changed their units.

use super::{Address, Link};
use geometry::{Sim3, median};
use map::{AgentId, Map, SemiDense};
use std::cmp::Ordering;

/// The closure in the units that the keyframes of `agent` have in `new`, where it was measured in those of `old`.
pub(super) fn follow(link: &Link, agent: AgentId, old: &Map, new: &Map) -> Link {
    let new_from_old = |address: &Address| -> Option<Sim3> {
        let depth = |map: &Map| Some(map.keyframes.get(&address.keyframe)?.semi_dense.clone());
        let scale = if address.agent == agent { factor(&*depth(old)?, &*depth(new)?) } else { None };
        scale.map(|scale| Sim3 { scale, ..Sim3::identity() })
    };
    let (from, to) = (new_from_old(&link.from), new_from_old(&link.to));
    if from.is_none() && to.is_none() {
        return *link;
    }
    let one = Sim3::identity();
    let carried = link.from_from_to.carried(&from.unwrap_or(one), &to.unwrap_or(one).inverse());
    carried.map_or(*link, |from_from_to| Link { from_from_to, ..*link })
}

/// By how much lengths in the new unit are more than in the old: the median over the pixels that have depth in
/// both. `None` where there are none, or nothing changed.
fn factor(old: &SemiDense, new: &SemiDense) -> Option<f64> {
    let (mut a, mut b) = (old.iter().peekable(), new.iter().peekable());
    let mut ratios = Vec::new();
    while let (Some(&(i, before, _)), Some(&(j, after, _))) = (a.peek(), b.peek()) {
        match i.cmp(&j) {
            Ordering::Less => _ = a.next(),
            Ordering::Greater => _ = b.next(),
            Ordering::Equal => {
                ratios.push(f64::from(before) / f64::from(after));
                a.next();
                b.next();
            }
        }
    }
    median(&mut ratios).filter(|m| m.is_finite() && *m > 0.0 && *m != 1.0)
}
