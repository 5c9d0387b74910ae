//! Time stamps: whole nanoseconds, as every form of recording holds them.
//!
//! A stamp that is on this grid from the start comes back bit for bit from any recording, and so does the
//! trajectory made from it. Decimal stamps with up to nine digits after the point are on it already.

pub use scans::tables::seconds;

const NS_PER_S: u64 = 1_000_000_000;
/// The first second that messages of Foxglove and ROS cannot hold: in the year 2106.
const END_S: f64 = u32::MAX as f64;
/// The whole nanoseconds nearest to a time in seconds; `None` where no recording can hold it: before 0,
/// after 2106, not a number.
pub fn nanoseconds(seconds: f64) -> Option<u64> {
    let whole = seconds.floor();
    let fraction = ((seconds - whole) * NS_PER_S as f64).round() as u64;
    (0.0..END_S).contains(&whole).then(|| whole as u64 * NS_PER_S + fraction)
}

/// The stamp on the grid nearest to `timestamp`; one that no recording can hold stays as it is.
pub fn on_grid(timestamp: f64) -> f64 {
    nanoseconds(timestamp).map_or(timestamp, seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_on_the_grid_stays_there() {
        let mut random = geometry::Random::new(7);
        for i in 0..200_000u64 {
            let bits = random.bits();
            // Of every magnitude, from nanoseconds to the end of time.
            let ns = (bits >> (i % 62)) % (u32::MAX as u64 * NS_PER_S);
            let stamp = seconds(ns);
            let again = nanoseconds(stamp).map(seconds);
            assert_eq!(again.map(f64::to_bits), Some(stamp.to_bits()), "{ns} ns");
            let any = bits as f64 / u64::MAX as f64 * 10f64.powi((i % 10) as i32);
            assert_eq!(on_grid(on_grid(any)).to_bits(), on_grid(any).to_bits(), "{any} s");
        }
    }

    #[test]
    fn decimal_stamps_are_on_the_grid() {
        for text in ["0.1", "0.3", "10.7", "1305031102.175304", "8388607.123456789", "1403636579.7635555"] {
            let stamp: f64 = text.parse().unwrap();
            assert_eq!(on_grid(stamp).to_bits(), stamp.to_bits(), "{text}");
        }
    }

    #[test]
    fn nanoseconds_since_1970_keep_a_microsecond() {
        assert_eq!(seconds(1403636579763555584), 1403636579.7635555);
    }

    #[test]
    fn what_cannot_be_held_stays() {
        assert!([-0.1, f64::NAN, f64::INFINITY, 5e9].iter().all(|&t| nanoseconds(t).is_none()));
        assert_eq!(on_grid(-0.123456789123), -0.123456789123);
    }
}
