//! The largest set of mutually joined vertices of a graph.

/// Vertices from which a greedy clique is grown; those with few neighbours seldom give the largest.
const MAX_STARTS: usize = 64;

/// A clique and whether it is known to be a largest one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Clique {
    /// Its vertices, ascending.
    pub vertices: Vec<usize>,
    /// Whether the search ended by itself, so that no larger clique exists.
    pub exact: bool,
}

/// A set of vertices, one bit each.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct VertexSet(Vec<u64>);

impl VertexSet {
    pub(super) fn empty(size: usize) -> Self {
        Self(vec![0; size.div_ceil(64)])
    }

    pub(super) fn insert(&mut self, vertex: usize) {
        self.0[vertex / 64] |= 1 << (vertex % 64);
    }

    fn remove(&mut self, vertex: usize) {
        self.0[vertex / 64] &= !(1 << (vertex % 64));
    }

    fn contains(&self, vertex: usize) -> bool {
        self.0[vertex / 64] >> (vertex % 64) & 1 == 1
    }

    fn is_empty(&self) -> bool {
        self.0.iter().all(|&word| word == 0)
    }

    fn len(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    fn intersection(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(a, b)| a & b).collect())
    }

    fn subtract(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a &= !b);
    }

    /// The smallest vertex.
    fn first(&self) -> Option<usize> {
        let word = self.0.iter().position(|&word| word != 0)?;
        Some(word * 64 + self.0[word].trailing_zeros() as usize)
    }

    fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.0.len() * 64).filter(|&vertex| self.contains(vertex))
    }
}

/// The largest clique among the `allowed` vertices of the graph whose vertex v is joined with `neighbours[v]`
/// (symmetric, no vertex its own neighbour).
///
/// A greedy clique is the start of a branch and bound with colours as bound (Tomita and Seki, 2003): vertices
/// of one colour are not joined, so a clique has at most one of each. The search gives up after `max_steps`
/// branches with the best clique so far. Of several largest ones, always the same comes out.
pub(super) fn largest(neighbours: &[VertexSet], allowed: &VertexSet, max_steps: usize) -> Clique {
    let mut search = Search { neighbours, best: greedy(neighbours, allowed), steps_left: max_steps };
    let exact = search.expand(&mut Vec::new(), allowed.clone());
    search.best.sort_unstable();
    Clique { vertices: search.best, exact }
}

struct Search<'a> {
    neighbours: &'a [VertexSet],
    best: Vec<usize>,
    steps_left: usize,
}

impl Search<'_> {
    /// Extends `clique` by `candidates`, all of which are joined with all of it; false when it gave up.
    fn expand(&mut self, clique: &mut Vec<usize>, mut candidates: VertexSet) -> bool {
        for (vertex, colours) in self.coloured(&candidates).into_iter().rev() {
            if clique.len() + colours <= self.best.len() {
                return true;
            }
            if self.steps_left == 0 {
                return false;
            }
            self.steps_left -= 1;
            clique.push(vertex);
            let joined = candidates.intersection(&self.neighbours[vertex]);
            if joined.is_empty() {
                if clique.len() > self.best.len() {
                    self.best = clique.clone();
                }
            } else if !self.expand(clique, joined) {
                return false;
            }
            clique.pop();
            candidates.remove(vertex);
        }
        true
    }

    /// The candidates with how many colours those up to and with each need, ascending.
    fn coloured(&self, candidates: &VertexSet) -> Vec<(usize, usize)> {
        let mut uncoloured = candidates.clone();
        let mut order = Vec::with_capacity(candidates.len());
        for colour in 1.. {
            if uncoloured.is_empty() {
                break;
            }
            let mut free = uncoloured.clone();
            while let Some(vertex) = free.first() {
                free.remove(vertex);
                free.subtract(&self.neighbours[vertex]);
                uncoloured.remove(vertex);
                order.push((vertex, colour));
            }
        }
        order
    }
}

/// From each of the vertices with most neighbours: takes the joined vertex with most neighbours, until none is
/// left; the largest such clique.
fn greedy(neighbours: &[VertexSet], allowed: &VertexSet) -> Vec<usize> {
    let degree: Vec<usize> = neighbours.iter().map(|of| of.intersection(allowed).len()).collect();
    let mut order: Vec<usize> = allowed.iter().collect();
    order.sort_by_key(|&vertex| (usize::MAX - degree[vertex], vertex));
    let mut best = Vec::new();
    for &start in order.iter().take(MAX_STARTS) {
        let mut clique = vec![start];
        let mut candidates = allowed.intersection(&neighbours[start]);
        // In the order of degree, the next candidate in it is the one with most neighbours.
        for &vertex in &order {
            if candidates.contains(vertex) {
                clique.push(vertex);
                candidates = candidates.intersection(&neighbours[vertex]);
            }
        }
        if clique.len() > best.len() {
            best = clique;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn graph(size: usize, joined: impl Fn(usize, usize) -> bool) -> Vec<VertexSet> {
        (0..size)
            .map(|v| {
                let mut set = VertexSet::empty(size);
                (0..size).filter(|&w| v != w && joined(v.min(w), v.max(w))).for_each(|w| set.insert(w));
                set
            })
            .collect()
    }

    fn all(size: usize) -> VertexSet {
        let mut set = VertexSet::empty(size);
        (0..size).for_each(|v| set.insert(v));
        set
    }

    fn is_clique(neighbours: &[VertexSet], vertices: &[usize]) -> bool {
        vertices.iter().all(|&v| vertices.iter().all(|&w| v == w || neighbours[v].contains(w)))
    }

    proptest! {
        #[test]
        fn as_large_as_brute_force_finds(
            bits in prop::collection::vec(any::<bool>(), 66), size in 1usize..12,
        ) {
            let neighbours = graph(size, |v, w| bits[w * (w - 1) / 2 + v]);
            let found = largest(&neighbours, &all(size), 100_000);
            let members = |set: u32| (0..size).filter(move |v| set >> v & 1 == 1).collect::<Vec<_>>();
            let brute = (0..1u32 << size)
                .filter(|&set| is_clique(&neighbours, &members(set)))
                .map(u32::count_ones)
                .max();
            prop_assert!(found.exact && is_clique(&neighbours, &found.vertices));
            prop_assert_eq!(Some(found.vertices.len() as u32), brute);
        }
    }

    #[test]
    fn a_planted_clique_is_found_in_a_large_graph() {
        // Every third of 300 vertices is in the clique; of the other pairs about three in ten are joined.
        let noise = |v: usize, w: usize| (v * 7919 + w * 104_729) % 97 < 30;
        let neighbours = graph(300, |v, w| (v % 3 == 0 && w % 3 == 0) || noise(v, w));
        let found = largest(&neighbours, &all(300), 100_000);
        assert_eq!(found.vertices, (0..300).step_by(3).collect::<Vec<_>>());
        assert!(found.exact);
    }

    #[test]
    fn a_search_that_gives_up_says_so_and_gives_a_clique() {
        let neighbours = graph(200, |v, w| (v * 7919 + w * 104_729) % 97 < 80);
        let found = largest(&neighbours, &all(200), 50);
        assert!(!found.exact && is_clique(&neighbours, &found.vertices) && found.vertices.len() > 5);
    }

    #[test]
    fn only_allowed_vertices_count() {
        let neighbours = graph(6, |_, _| true);
        let mut allowed = VertexSet::empty(6);
        [1, 4].into_iter().for_each(|v| allowed.insert(v));
        assert_eq!(largest(&neighbours, &allowed, 100).vertices, [1, 4]);
        assert!(largest(&neighbours, &VertexSet::empty(6), 100).vertices.is_empty());
    }
}
