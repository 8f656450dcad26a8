//! List of all constants of the shading of walls.

use crate::{bricks, exposure, packet, shared_constants::SharedConstant, silhouette};

/// Return names and values of all constants of the shading of walls; the names are unique.
#[must_use]
pub fn shading_constants() -> Vec<SharedConstant> {
    [
        bricks::shared(),
        exposure::shared(),
        packet::shared(),
        silhouette::shared(),
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SharedValue;

    #[test]
    fn shared_constants_have_unique_names() {
        let mut names: Vec<_> = shading_constants()
            .into_iter()
            .map(|(name, _)| name)
            .collect();
        let num_names = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), num_names);
    }

    #[test]
    fn shared_constants_have_the_values_of_the_casters() {
        let all = shading_constants();
        let value = |wanted: &str| all.iter().find(|(name, _)| *name == wanted).map(|c| &c.1);
        assert_eq!(value("AXIS_AT"), Some(&SharedValue::Float(1.2)));
        assert_eq!(value("METERED"), Some(&SharedValue::Unsigned(12)));
        assert!(matches!(value("HUE"), Some(SharedValue::Rows(rows)) if rows.len() == 3));
    }
}
