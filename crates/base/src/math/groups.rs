//! Things that hang together through others.

/// Groups in which each thing is linked to another of its group, and to none outside. `linked` must not depend on the order of
/// its two. Groups and what they hold come in an order that only that of the things decides. O(n²) calls of `linked`.
pub fn linked_groups<T>(things: Vec<T>, linked: impl Fn(&T, &T) -> bool) -> Vec<Vec<T>> {
    let mut left = things;
    let mut groups = Vec::new();
    while let Some(first) = left.pop() {
        let mut group = vec![first];
        let mut next = 0;
        while next < group.len() {
            let (near, far): (Vec<T>, Vec<T>) = left
                .into_iter()
                .partition(|thing| linked(thing, &group[next]));
            group.extend(near);
            left = far;
            next += 1;
        }
        groups.push(group);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_hangs_together_through_others_is_one_group() {
        let things = vec![7, 1, 20, 2, 9, 3, 21, 40];
        let mut groups = linked_groups(things, |a: &i32, b| (a - b).abs() <= 2);
        for group in &mut groups {
            group.sort_unstable();
        }
        groups.sort();
        assert_eq!(groups, [vec![1, 2, 3], vec![7, 9], vec![20, 21], vec![40]]);
        assert!(linked_groups(Vec::<i32>::new(), |_, _| true).is_empty());
    }
}
