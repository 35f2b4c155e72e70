//! Interface functions as tables: state, message, next state.

/// One arrow of a state diagram.
pub type Arrow<State, Message> = (State, Message, State);

/// The state after a message: that of the first arrow that fits, else `state` itself.
pub fn next<State: Copy + PartialEq, Message: Copy + PartialEq>(
    arrows: &[Arrow<State, Message>],
    state: State,
    message: Message,
) -> State {
    arrows.iter().find(|(from, on, _)| *from == state && *on == message).map_or(state, |(_, _, to)| *to)
}
