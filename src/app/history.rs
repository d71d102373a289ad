//! States before and after the present one, to go back and forth between.

/// What can be undone and done again; the present state is its owner's.
pub(super) struct History<T> {
    done: Vec<T>,
    undone: Vec<T>,
}

impl<T> History<T> {
    /// Without a past.
    pub(super) fn new() -> Self {
        Self {
            done: Vec::new(),
            undone: Vec::new(),
        }
    }

    /// Keeps a state that is about to change, or has changed; what was undone can't be done again.
    pub(super) fn keep(&mut self, before: T) {
        self.done.push(before);
        self.undone.clear();
    }

    pub(super) fn can_undo(&self) -> bool {
        !self.done.is_empty()
    }

    pub(super) fn can_redo(&self) -> bool {
        !self.undone.is_empty()
    }

    /// Goes back by one state; whether there was one.
    pub(super) fn undo(&mut self, now: &mut T) -> bool {
        step(&mut self.done, &mut self.undone, now)
    }

    /// Goes forth by one state; whether there was one.
    pub(super) fn redo(&mut self, now: &mut T) -> bool {
        step(&mut self.undone, &mut self.done, now)
    }
}

/// Takes the last state of one list, and puts the present one on the other.
fn step<T>(from: &mut Vec<T>, to: &mut Vec<T>, now: &mut T) -> bool {
    let next = from.pop();
    let any = next.is_some();
    to.extend(next.map(|next| std::mem::replace(now, next)));
    any
}
