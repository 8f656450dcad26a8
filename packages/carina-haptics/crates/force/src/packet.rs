//! Binary UDP messages between a device's bridge and the force loop: fixed size, little-endian (table in the guide).

use crate::law::{HandForce, HandSample};
use crate::vector::Point;

/// First bytes of every message.
const MAGIC: [u8; 4] = *b"CARH";
/// Version of the message format.
const VERSION: u8 = 1;
/// Kind of a message with a sample.
const KIND_SAMPLE: u8 = 1;
/// Kind of a message with a force.
const KIND_FORCE: u8 = 2;
/// Size of a message with a sample, in bytes.
pub const SAMPLE_BYTES: usize = 96;
/// Size of a message with a force, in bytes.
pub const FORCE_BYTES: usize = 72;

/// Message with a sample from a bridge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamplePacket {
    /// Number of the sample; the message with its force has the same number.
    pub number: u32,
    /// Time of the device's clock, us; the message with the force has the same value.
    pub device_us: u64,
    /// State of the device's buttons, one bit per button.
    pub buttons: u16,
    /// Position, velocity and direction of the hand, in the space of the device.
    pub hand: HandSample,
}

/// Message with a force for a bridge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForcePacket {
    /// Number of the sample from which the force was computed.
    pub number: u32,
    /// Time of the device's clock in that sample, us.
    pub device_us: u64,
    /// Force on the hand, in the axes of the device.
    pub felt: HandForce,
}

fn put(bytes: &mut [u8], at: usize, v: Point) {
    for (a, value) in v.iter().enumerate() {
        bytes[at + 8 * a..at + 8 * a + 8].copy_from_slice(&value.to_le_bytes());
    }
}

fn take<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

fn point(bytes: &[u8], at: usize) -> Point {
    std::array::from_fn(|a| f64::from_le_bytes(take(bytes, at + 8 * a)))
}

fn head(kind: u8, flags: u16, number: u32, device_us: u64, bytes: &mut [u8]) {
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[4] = VERSION;
    bytes[5] = kind;
    bytes[6..8].copy_from_slice(&flags.to_le_bytes());
    bytes[8..12].copy_from_slice(&number.to_le_bytes());
    bytes[16..24].copy_from_slice(&device_us.to_le_bytes());
}

fn is_ours(bytes: &[u8], kind: u8, size: usize) -> bool {
    bytes.len() == size && bytes[..4] == MAGIC && bytes[4] == VERSION && bytes[5] == kind
}

impl SamplePacket {
    /// Encode the message as bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; SAMPLE_BYTES] {
        let mut bytes = [0; SAMPLE_BYTES];
        head(
            KIND_SAMPLE,
            self.buttons,
            self.number,
            self.device_us,
            &mut bytes,
        );
        put(&mut bytes, 24, self.hand.at_lps);
        put(&mut bytes, 48, self.hand.velocity_mm_s);
        put(&mut bytes, 72, self.hand.forward_lps);
        bytes
    }

    /// Decode a message with a sample; return `None` for bytes that are not a plausible sample of this version.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        if !is_ours(bytes, KIND_SAMPLE, SAMPLE_BYTES) {
            return None;
        }
        let found = Self {
            number: u32::from_le_bytes(take(bytes, 8)),
            device_us: u64::from_le_bytes(take(bytes, 16)),
            buttons: u16::from_le_bytes(take(bytes, 6)),
            hand: HandSample {
                at_lps: point(bytes, 24),
                velocity_mm_s: point(bytes, 48),
                forward_lps: point(bytes, 72),
            },
        };
        found.hand.is_sane().then_some(found)
    }
}

impl ForcePacket {
    /// Encode the message as bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; FORCE_BYTES] {
        let mut bytes = [0; FORCE_BYTES];
        let flags = u16::from(self.felt.touches)
            | u16::from(self.felt.limited) << 1
            | u16::from(self.felt.is_silent) << 2;
        head(KIND_FORCE, flags, self.number, self.device_us, &mut bytes);
        put(&mut bytes, 24, self.felt.force_n);
        put(&mut bytes, 48, self.felt.torque_n_mm);
        bytes
    }

    /// Decode a message with a force; return `None` for bytes that are not a force of this version.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        if !is_ours(bytes, KIND_FORCE, FORCE_BYTES) {
            return None;
        }
        let flags = u16::from_le_bytes(take(bytes, 6));
        Some(Self {
            number: u32::from_le_bytes(take(bytes, 8)),
            device_us: u64::from_le_bytes(take(bytes, 16)),
            felt: HandForce {
                force_n: point(bytes, 24),
                torque_n_mm: point(bytes, 48),
                touches: flags & 1 != 0,
                limited: flags & 2 != 0,
                is_silent: flags & 4 != 0,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample() -> SamplePacket {
        SamplePacket {
            number: 7,
            device_us: 123_456_789_012,
            buttons: 5,
            hand: HandSample {
                at_lps: [1.5, -2.25, 900.0],
                velocity_mm_s: [0.0, -3.5, 1e3],
                forward_lps: [0.6, 0.0, -0.8],
            },
        }
    }

    #[test]
    fn decoded_packets_equal_the_encoded_ones() {
        assert_eq!(
            SamplePacket::from_bytes(&sample().to_bytes()),
            Some(sample())
        );
        let force = ForcePacket {
            number: 7,
            device_us: 9,
            felt: HandForce {
                force_n: [0.1, 0.2, -3.0],
                torque_n_mm: [4.0, 5.0, 6.0],
                touches: true,
                limited: false,
                is_silent: true,
            },
        };
        assert_eq!(ForcePacket::from_bytes(&force.to_bytes()), Some(force));
    }

    #[test]
    fn invalid_packets_are_not_decoded_as_samples() {
        let good = sample().to_bytes();
        for at in 0..6 {
            let mut bad = good;
            bad[at] ^= 0x40;
            assert_eq!(SamplePacket::from_bytes(&bad), None);
        }
        assert_eq!(SamplePacket::from_bytes(&good[..95]), None);
        let mut nan = sample();
        nan.hand.at_lps[1] = f64::NAN;
        assert_eq!(SamplePacket::from_bytes(&nan.to_bytes()), None);
    }

    proptest! {
        #[test]
        fn decoding_any_bytes_does_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = SamplePacket::from_bytes(&bytes);
            let _ = ForcePacket::from_bytes(&bytes);
        }
    }
}
