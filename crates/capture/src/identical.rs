//! Finds photographs with the same pixels.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use crate::CaptureView;
use crate::error::name_list;
use crate::photos::Split;

/// A warning about photographs with equal pixels, and about those of which one is trained on and one held out. `splits` belong to
/// `views`.
pub(super) fn check(views: &[CaptureView], splits: &[Split]) -> Option<String> {
    let mut groups: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for (i, view) in views.iter().enumerate() {
        let mut hasher = DefaultHasher::new();
        view.image.hash(&mut hasher);
        groups.entry(hasher.finish()).or_default().push(i);
    }
    let (mut copies, mut leaks) = (Vec::new(), 0);
    for group in groups.values() {
        let same: Vec<usize> =
            group.iter().copied().filter(|i| views[*i].image == views[group[0]].image).collect();
        let (first, others) = same.split_first()?;
        copies.extend(others.iter().map(|i| format!("{} (as {})", views[*i].name, views[*first].name)));
        let is_split = others.iter().any(|i| splits[*i] != splits[*first]);
        leaks += usize::from(is_split);
    }
    let leak = if leaks > 0 {
        "; some are in training and held out at once, so the figures of held-out views are too good"
    } else {
        ""
    };
    (!copies.is_empty()).then(|| {
        format!("photographs that equal another one: {}{leak}: {}", copies.len(), name_list(&copies))
    })
}
