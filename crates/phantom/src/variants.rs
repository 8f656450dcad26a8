//! Anatomical variants of the phantom's airways, and their published frequencies.

use crate::random::Random;

/// Anatomical variants of a tree of airways; variants that exclude each other are refused by [`Variants::conflict`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "independent variants, each named where it is set"
)]
pub struct Variants {
    /// RB1 arises from the trachea above the carina.
    pub tracheal_bronchus: bool,
    /// The right basal trunk has a subsuperior bronchus, RB*.
    pub subsuperior: bool,
    /// RB7 is absent.
    pub absent_rb7: bool,
    /// The right upper lobe's bronchus and the left basal trunk divide in three, and the right basal trunk in all its
    /// segments.
    pub trifurcations: bool,
    /// Both lungs have the lobes and segments of a left lung.
    pub left_isomerism: bool,
    /// The left basal trunk divides in three with its published frequency.
    ///
    /// Other chests of this crate have a larger share of such trunks; they retain their voxels.
    pub published: bool,
}

/// Names of the variants, in the order of the fields of [`Variants`].
pub const VARIANT_NAMES: [&str; 5] = [
    "tracheal-bronchus",
    "subsuperior",
    "absent-rb7",
    "trifurcations",
    "left-isomerism",
];
/// Name that selects random variants with their published frequencies.
pub const PUBLISHED: &str = "published";

/// Share of chests with a tracheal bronchus: 0.1 to 2 %.
const TRACHEAL_BRONCHUS: f64 = 0.01;
/// Share of chests with a subsuperior bronchus (MESA, n = 3,169).
const SUBSUPERIOR: f64 = 0.16;
/// Share of chests without RB7 (MESA, n = 3,169).
const ABSENT_RB7: f64 = 0.061;
/// Share of chests with a left isomerism.
///
/// Heterotaxy occurs in 0.8 of 10,000 births (Lin 2014), and 35 of 78 isomeric bronchial trees are left isomeric (Oreto
/// 2023).
const LEFT_ISOMERISM: f64 = 0.000_036;
/// Share of left basal trunks that divide in three, of those that divide in two or three: 18 of 93 % (n = 216).
pub(crate) const LEFT_BASAL_TRIFURCATION: f64 = 0.19;

impl Variants {
    /// Return the variants of a name, chosen at random for [`PUBLISHED`]; `None` for an unknown name.
    #[must_use]
    pub fn named(name: &str, seed: u64) -> Option<Self> {
        let mut found = Self::default();
        match name {
            "tracheal-bronchus" => found.tracheal_bronchus = true,
            "subsuperior" => found.subsuperior = true,
            "absent-rb7" => found.absent_rb7 = true,
            "trifurcations" => found.trifurcations = true,
            "left-isomerism" => found.left_isomerism = true,
            PUBLISHED => found = Self::published(seed),
            _ => return None,
        }
        Some(found)
    }

    /// Return random variants from a seed, each with its published frequency.
    #[must_use]
    pub fn published(seed: u64) -> Self {
        let mut random = Random::new(seed, 10);
        let mut drawn = [TRACHEAL_BRONCHUS, SUBSUPERIOR, ABSENT_RB7, LEFT_ISOMERISM]
            .map(|share| random.unit() < share);
        if drawn[3] {
            // The mirror image of a left lung has none of the variants of a right one.
            drawn = [false, false, false, true];
        }
        Self {
            tracheal_bronchus: drawn[0],
            subsuperior: drawn[1],
            absent_rb7: drawn[2],
            trifurcations: false,
            left_isomerism: drawn[3],
            published: true,
        }
    }

    /// Return the names of the variants that the tree has.
    #[must_use]
    pub fn names(&self) -> Vec<&'static str> {
        let has = [
            self.tracheal_bronchus,
            self.subsuperior,
            self.absent_rb7,
            self.trifurcations,
            self.left_isomerism,
        ];
        VARIANT_NAMES
            .into_iter()
            .zip(has)
            .filter_map(|(name, has)| has.then_some(name))
            .collect()
    }

    /// Return whether an option that changes the airways cannot be combined with the variants.
    #[must_use]
    pub(crate) fn conflict(self) -> bool {
        self.left_isomerism
            && (self.tracheal_bronchus || self.subsuperior || self.absent_rb7 || self.trifurcations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_of_many_seeds_have_the_published_frequencies() {
        let num = 20_000;
        let count = |has: fn(&Variants) -> bool| {
            (0..num)
                .filter(|&seed| has(&Variants::published(seed)))
                .count() as f64
                / num as f64
        };
        // The tolerance is four standard deviations of a share in 20,000 draws.
        for (found, share) in [
            (count(|v| v.tracheal_bronchus), TRACHEAL_BRONCHUS),
            (count(|v| v.subsuperior), SUBSUPERIOR),
            (count(|v| v.absent_rb7), ABSENT_RB7),
            (count(|v| v.left_isomerism), LEFT_ISOMERISM),
        ] {
            let spread = (share * (1.0 - share) / num as f64).sqrt();
            assert!(
                (found - share).abs() < 4.0 * spread + 1e-4,
                "{found} {share}"
            );
        }
    }

    #[test]
    fn every_name_selects_its_own_variant() {
        for name in VARIANT_NAMES {
            assert_eq!(Variants::named(name, 3).unwrap().names(), [name]);
        }
        assert_eq!(Variants::named("situs-inversus", 3), None);
    }
}
