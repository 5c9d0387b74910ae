//! What the numbers of a `.bin` file are: little-endian float32, but of 3 to 6 columns, of which nothing in the file tells.
//!
//! How many there are is told by the period with which the numbers repeat: from a point to the next, each column changes
//! less than from one column to another. Which column holds the ring and which the time is told by what they go with: the ring with
//! the elevation, the time with the azimuth or the order of points.

use std::f32::consts::PI;

/// How the points of a `.bin` file are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BinLayout {
    /// Numbers of a point; the first three are x, y and z.
    pub floats: usize,
    /// The column of the ring.
    pub ring: Option<usize>,
    /// The column of the time.
    pub time: Option<usize>,
    /// Another count of numbers that fits as well.
    pub other: Option<usize>,
}

impl Default for BinLayout {
    /// KITTI's: x y z intensity.
    fn default() -> Self {
        Self { floats: 4, ring: None, time: None, other: None }
    }
}

impl BinLayout {
    /// The columns, for people: `x y z intensity ring`.
    pub fn columns(&self) -> String {
        let mut names = vec!["x", "y", "z"];
        for column in 3..self.floats {
            names.push(match column {
                _ if self.ring == Some(column) => "ring",
                _ if self.time == Some(column) => "time",
                3 => "intensity",
                _ => "?",
            });
        }
        names.join(" ")
    }

    /// Bytes of a point.
    pub fn bytes(&self) -> usize {
        4 * self.floats
    }
}

/// Numbers that a point may have.
const COLUMNS: [usize; 4] = [3, 4, 5, 6];
/// Two counts fit as well as each other when columns change from point to point by no more than this, as a logarithm of the ratio: a
/// count that is wrong mixes columns and makes it more than 2.
const AS_WELL: f32 = 0.2;
/// Coordinates of points, metres or millimetres, lie between these; numbers that are none in float32 mostly do not.
const PLAUSIBLE: std::ops::RangeInclusive<f32> = 1e-5..=1e7;
/// Fewest points from which anything is told.
const LEAST: usize = 64;
/// A ring's points have elevations this much nearer to each other than all have, and those of one azimuth times.
const SAME_RING: f32 = 0.25;

/// Part of a file.
pub struct Sample {
    /// Bytes of the whole file.
    pub length: u64,
    /// Its first bytes.
    pub head: Vec<u8>,
}

/// The layout of a folder's files, of which `samples` are some; says why where they are no points.
pub fn layout_of(samples: &[Sample]) -> Result<BinLayout, String> {
    let fits = |floats: usize| {
        samples.iter().filter(|s| s.length > 0 && s.length.is_multiple_of(4 * floats as u64)).count()
    };
    let most = COLUMNS.map(fits).into_iter().max().unwrap_or(0);
    if let Some(other) = another_form(samples, most) {
        return Err(other);
    }
    if most == 0 {
        // Of files that are all cut off each is told when it is read.
        return Ok(BinLayout::default());
    }
    let heads: Vec<Vec<f32>> = samples.iter().map(|sample| numbers(&sample.head)).collect();
    let heads: Vec<&Vec<f32>> = heads.iter().filter(|head| head.iter().any(|v| v.is_finite())).collect();
    if heads.is_empty() {
        return Ok(BinLayout::default());
    }
    if !heads.iter().any(|head| are_coordinates(head)) {
        return Err(
            "the numbers are no float32 coordinates; points of 3 to 6 float32 (x y z …) are read".into()
        );
    }
    let mut scored: Vec<(usize, f32)> = COLUMNS
        .into_iter()
        .filter(|&floats| fits(floats) == most)
        .filter_map(|floats| Some((floats, change(&heads, floats)?)))
        .collect();
    // Points of three numbers repeat after six as well, and better where lasers fire in turns.
    let threes = scored.iter().any(|(floats, _)| *floats == 3) && are_threes(&heads);
    if threes {
        scored.retain(|(floats, _)| *floats != 6);
    }
    scored.sort_by(|a, b| a.1.total_cmp(&b.1));
    let Some(&(best, change)) = scored.first() else { return Ok(BinLayout::default()) };
    let as_well: Vec<usize> =
        scored.iter().filter(|(_, other)| other - change < AS_WELL).map(|(floats, _)| *floats).collect();
    let richest = as_well.iter().copied().max().unwrap_or(best);
    let other = as_well.iter().copied().filter(|&floats| floats != richest).max();
    let ring = (3..richest).find(|&column| heads.iter().any(|head| is_ring(head, richest, column)));
    let time = (3..richest)
        .filter(|&column| Some(column) != ring)
        .find(|&column| heads.iter().any(|head| is_time(head, richest, column)));
    Ok(BinLayout { floats: richest, ring, time, other })
}

/// What files hold that are no points of float32 in these numbers of columns, `most` of which fit their lengths; nothing where nothing says so.
fn another_form(samples: &[Sample], most: usize) -> Option<String> {
    let whole = |bytes: u64| samples.iter().all(|s| s.length > 0 && s.length.is_multiple_of(bytes));
    let counts = |sample: &Sample| {
        let (count, rest) = sample.head.split_first_chunk::<4>()?;
        let count = u64::from(u32::from_le_bytes(*count));
        let is_count = |floats: usize| sample.length == 4 + count * 4 * floats as u64;
        COLUMNS.into_iter().find(|floats| count > 0 && !rest.is_empty() && is_count(*floats))
    };
    let columns = samples.first().and_then(counts);
    if let Some(columns) = columns.filter(|_| samples.iter().all(|sample| counts(sample) == columns)) {
        return Some(format!(
            "each file begins with the count of its points, which is none of them; write the {columns} float32 of each point alone, or \
             PCD or PLY files"
        ));
    }
    // Doubles of four coordinates are as long as eight float32.
    if [24, 32].into_iter().any(whole) && samples.iter().any(|sample| are_doubles(&sample.head)) {
        return Some("the numbers are float64; points of 3 to 6 float32 (x y z …) are read".into());
    }
    let other = (7..=10).find(|floats| whole(4 * floats)).filter(|_| most < samples.len());
    other.map(|floats| {
        format!("the files are as long as points of {floats} float32 make them; points of 3 to 6 float32 (x y z …) are read")
    })
}

/// Whether nearly all numbers are coordinates or 0 as float64, which float32 read so are by chance, a few of them.
fn are_doubles(bytes: &[u8]) -> bool {
    let numbers = bytes.as_chunks::<8>().0;
    let is_plausible = |v: f64| v == 0.0 || (1e-4..=1e4).contains(&v.abs());
    let plausible = numbers.iter().filter(|b| is_plausible(f64::from_le_bytes(**b))).count();
    // All zero says nothing.
    let is_set = numbers.iter().any(|b| b.iter().any(|byte| *byte != 0));
    numbers.len() >= LEAST && is_set && 20 * plausible > 19 * numbers.len()
}

fn numbers(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

/// Whether numbers are such as coordinates are, or 0; times may be others. Of doubles read so three in four are at the most: of the half
/// that holds their last bits, those are whose exponent, taken from these, happens to be one of a coordinate.
fn are_coordinates(numbers: &[f32]) -> bool {
    let finite = numbers.iter().filter(|v| v.is_finite()).count();
    let plausible = numbers.iter().filter(|v| **v == 0.0 || PLAUSIBLE.contains(&v.abs())).count();
    5 * plausible > 4 * finite
}

/// Whether points of six numbers are twice as many of three: one lies in the direction of the other, or the last three columns are spread
/// as the first three are.
fn are_threes(heads: &[&Vec<f32>]) -> bool {
    /// Points that follow each other lie in one direction but for this, radians: those of one firing, or of the next.
    const ASIDE: f32 = 0.1;
    let aside = |six: &[f32]| (six[1].atan2(six[0]) - six[4].atan2(six[3])).sin().abs();
    let sixes = heads.iter().flat_map(|head| head.chunks_exact(6));
    let mut apart: Vec<f32> = sixes.map(aside).filter(|v| v.is_finite()).collect();
    median(&mut apart).is_some_and(|apart| apart < ASIDE) || are_similar(heads)
}

/// Whether the last three of six columns have the quartiles of the first three.
fn are_similar(heads: &[&Vec<f32>]) -> bool {
    let quartiles = |column: usize| {
        let numbers =
            heads.iter().flat_map(|head| head.iter().skip(column).step_by(6)).filter(|v| v.is_finite());
        let mut numbers: Vec<f32> = numbers.copied().collect();
        numbers.sort_by(f32::total_cmp);
        (!numbers.is_empty()).then(|| [1, 2, 3].map(|quarter| numbers[(numbers.len() - 1) * quarter / 4]))
    };
    (0..3).all(|column| {
        let (Some(a), Some(b)) = (quartiles(column), quartiles(column + 3)) else { return false };
        let spread = (a[2] - a[0]).max(b[2] - b[0]);
        a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= AS_WELL * spread)
    })
}

/// How much the columns change from point to point: mean over the columns of the logarithm of the median change.
fn change(heads: &[&Vec<f32>], floats: usize) -> Option<f32> {
    let whole: Vec<&&Vec<f32>> = heads.iter().filter(|head| head.len() >= LEAST * floats).collect();
    let mut sizes: Vec<f32> = whole
        .iter()
        .flat_map(|head| head.iter())
        .filter(|v| v.is_finite() && **v != 0.0)
        .map(|v| v.abs())
        .collect();
    // What does not change at all is no better than what hardly does.
    let least = 1e-3 * median(&mut sizes)?;
    let of_column = |column: usize| {
        let changes = whole.iter().flat_map(|head| {
            let column = head[column..].iter().step_by(floats);
            column.clone().zip(column.skip(1)).map(|(a, b)| (a - b).abs())
        });
        let mut changes: Vec<f32> = changes.filter(|v| v.is_finite()).collect();
        Some((median(&mut changes)? + least).ln())
    };
    let sum = (0..floats).map(of_column).sum::<Option<f32>>()?;
    Some(sum / floats as f32)
}

fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Points with a value beside them, those that are finite and not in the sensor.
fn paired(head: &[f32], floats: usize, column: usize) -> Vec<([f32; 3], f32)> {
    let points = head.chunks_exact(floats).map(|p| ([p[0], p[1], p[2]], p[column]));
    let is_usable = |p: &([f32; 3], f32)| {
        p.0.iter().all(|v| v.is_finite()) && p.0.iter().any(|v| *v != 0.0) && p.1.is_finite()
    };
    points.filter(is_usable).collect()
}

/// Median distance of values from the median of their group, over the same of all of them together.
fn spread_within(grouped: &mut [(usize, f32)]) -> Option<f32> {
    let mut all: Vec<f32> = grouped.iter().map(|(_, value)| *value).collect();
    let middle = median(&mut all)?;
    let mut whole: Vec<f32> = all.iter().map(|v| (v - middle).abs()).collect();
    let whole = median(&mut whole).filter(|spread| *spread > 0.0)?;
    grouped.sort_by_key(|(group, _)| *group);
    let mut within = Vec::with_capacity(grouped.len());
    for group in grouped.chunk_by(|a, b| a.0 == b.0) {
        let mut values: Vec<f32> = group.iter().map(|(_, value)| *value).collect();
        let middle = median(&mut values)?;
        within.extend(values.iter().map(|v| (v - middle).abs()));
    }
    Some(median(&mut within)? / whole)
}

/// Whether a column of whole numbers goes with the elevation.
fn is_ring(head: &[f32], floats: usize, column: usize) -> bool {
    let points = paired(head, floats, column);
    let are_whole = points.iter().all(|(_, ring)| ring.fract() == 0.0 && (0.0..256.0).contains(ring));
    let mut grouped: Vec<(usize, f32)> =
        points.iter().map(|(p, ring)| (*ring as usize, p[2].atan2(p[0].hypot(p[1])))).collect();
    are_whole && points.len() >= LEAST && spread_within(&mut grouped).is_some_and(|share| share < SAME_RING)
}

/// Whether a column goes with the azimuth, or grows from point to point.
fn is_time(head: &[f32], floats: usize, column: usize) -> bool {
    /// Directions that times are compared in: those of one differ by a hundredth of a sweep.
    const SECTORS: f32 = 120.0;
    let points = paired(head, floats, column);
    if points.len() < LEAST || points.iter().all(|(_, time)| *time == points[0].1) {
        return false;
    }
    let grows = points.windows(2).filter(|w| w[1].1 >= w[0].1).count();
    let sector = |p: &[f32; 3]| ((p[1].atan2(p[0]) + PI) / (2.0 * PI) * SECTORS) as usize;
    let mut grouped: Vec<(usize, f32)> = points.iter().map(|(p, time)| (sector(p), *time)).collect();
    20 * grows > 19 * points.len() || spread_within(&mut grouped).is_some_and(|share| share < SAME_RING)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::TAU;

    /// A sweep in a room of so many rings, firing by firing or ring by ring; `extra` gives what follows x, y and z of a column and ring.
    fn sample(extra: impl Fn(usize, usize) -> Vec<f32>, by_ring: bool) -> Sample {
        let (rings, columns) = (16, 400);
        let point = |column: usize, ring: usize| {
            let azimuth = -TAU * column as f32 / columns as f32;
            let elevation = (2.0 * ring as f32 - 15.0).to_radians();
            let range = (6.0 / azimuth.cos().abs().max(azimuth.sin().abs())).min(2.0 / elevation.sin().abs());
            let level = range * elevation.cos();
            let xyz = [level * azimuth.cos(), level * azimuth.sin(), range * elevation.sin()];
            xyz.into_iter().chain(extra(column, ring)).flat_map(f32::to_le_bytes).collect::<Vec<u8>>()
        };
        let bytes: Vec<u8> = if by_ring {
            (0..rings).flat_map(|ring| (0..columns).flat_map(move |column| point(column, ring))).collect()
        } else {
            (0..columns).flat_map(|column| (0..rings).flat_map(move |ring| point(column, ring))).collect()
        };
        Sample { length: bytes.len() as u64, head: bytes }
    }

    /// Intensities that look like noise, from 0 to 255.
    fn intensity(column: usize, ring: usize) -> f32 {
        ((column * 7919 + ring * 104_729) % 251) as f32
    }

    fn inferred(extra: impl Fn(usize, usize) -> Vec<f32> + Copy) -> [String; 2] {
        [false, true].map(|by_ring| layout_of(&[sample(extra, by_ring)]).unwrap().columns())
    }

    #[test]
    fn other_layouts_are_named_in_the_error() {
        let plain = sample(|c, r| vec![intensity(c, r)], false);
        let doubles: Vec<u8> =
            numbers(&plain.head).iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
        let doubles = Sample { length: doubles.len() as u64, head: doubles };
        assert!(layout_of(&[doubles]).unwrap_err().contains("float64"));
        let counted = [&(plain.length as u32 / 16).to_le_bytes()[..], &plain.head].concat();
        let counted = Sample { length: counted.len() as u64, head: counted };
        assert!(layout_of(&[counted]).unwrap_err().contains("begins with the count"));
        let seven = sample(|c, r| vec![intensity(c, r), 1.0, 2.0, 3.0], false);
        // Of several files not all are as long as points of other numbers.
        let shorter = |points: u64| Sample { length: seven.length - 28 * points, head: seven.head.clone() };
        assert!(layout_of(&[1, 2, 3].map(shorter)).unwrap_err().contains("7 float32"));
    }

    #[test]
    fn columns_are_recognised_by_the_numbers() {
        assert_eq!(inferred(|_, _| vec![]), ["x y z"; 2]);
        assert_eq!(inferred(|c, r| vec![intensity(c, r)]), ["x y z intensity"; 2]);
        assert_eq!(inferred(|c, r| vec![intensity(c, r) / 255.0]), ["x y z intensity"; 2]);
        assert_eq!(inferred(|_, _| vec![0.0]), ["x y z intensity"; 2]);
        assert_eq!(inferred(|c, r| vec![intensity(c, r), r as f32]), ["x y z intensity ring"; 2]);
        assert_eq!(inferred(|c, r| vec![intensity(c, r), c as f32 * 2.5e-4]), ["x y z intensity time"; 2]);
        assert_eq!(
            inferred(|c, r| vec![intensity(c, r), r as f32, c as f32 * 2.5e-4]),
            ["x y z intensity ring time"; 2]
        );
        assert_eq!(
            inferred(|c, r| vec![r as f32, intensity(c, r), c as f32 * 250.0]),
            ["x y z ring ? time"; 2]
        );
    }

    #[test]
    fn points_in_no_order_are_recognised_as_well() {
        for floats in 3..=6usize {
            let whole = sample(
                |c, r| [intensity(c, r) / 255.0, r as f32, c as f32 * 2.5e-4][..floats - 3].to_vec(),
                false,
            );
            let mut points: Vec<&[u8]> = whole.head.chunks_exact(4 * floats).collect();
            let mut state = 1u64;
            for i in (1..points.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                points.swap(i, (state >> 33) as usize % (i + 1));
            }
            let head = points.concat();
            let found = layout_of(&[Sample { length: head.len() as u64, head }]).unwrap();
            assert_eq!(found.floats, floats, "{found:?}");
        }
    }

    /// A VLP-16 fires its lasers in turns, low and high.
    #[test]
    fn points_of_three_numbers_are_recognised_where_lasers_fire_one_after_another() {
        for floats in [3, 4, 6usize] {
            let whole =
                sample(|c, r| [intensity(c, r), r as f32, c as f32 * 2.5e-4][..floats - 3].to_vec(), false);
            let turns = whole.head.chunks_exact(16 * 4 * floats).flat_map(|firing| {
                let points: Vec<&[u8]> = firing.chunks_exact(4 * floats).collect();
                (0..16).flat_map(|i| points[i / 2 + 8 * (i % 2)].to_vec()).collect::<Vec<u8>>()
            });
            let head: Vec<u8> = turns.collect();
            let found = layout_of(&[Sample { length: head.len() as u64, head }]).unwrap();
            assert_eq!(found.floats, floats, "{found:?}");
        }
    }

    #[test]
    fn lengths_of_several_files_count_and_files_that_are_cut_off_do_not() {
        let mut short = sample(|c, r| vec![intensity(c, r), r as f32], false);
        short.head.truncate(1003);
        short.length = 1003;
        let whole = || sample(|c, r| vec![intensity(c, r), r as f32], true);
        let empty = Sample { length: 0, head: Vec::new() };
        assert_eq!(layout_of(&[whole(), short, empty, whole()]).unwrap().floats, 5);
    }

    #[test]
    fn numbers_that_are_no_coordinates_are_refused() {
        // NCLT's: unsigned 16-bit x y z, two bytes more.
        let words = sample(|c, r| vec![intensity(c, r)], false);
        let bytes: Vec<u8> = numbers(&words.head)
            .chunks_exact(4)
            .flat_map(|p| {
                let of = |v: f32| (((v + 100.0) / 0.005) as u16).to_le_bytes();
                [of(p[0]), of(p[1]), of(p[2]), [p[3] as u8, 3]].concat()
            })
            .collect();
        let refused = layout_of(&[Sample { length: bytes.len() as u64, head: bytes }]).unwrap_err();
        assert!(refused.contains("no float32 coordinates"), "{refused}");
        // And of doubles.
        let doubles: Vec<u8> =
            numbers(&words.head).iter().flat_map(|v| f64::from(*v * 1.1).to_le_bytes()).collect();
        assert!(layout_of(&[Sample { length: doubles.len() as u64, head: doubles }]).is_err());
    }
}
