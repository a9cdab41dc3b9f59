"""The one exception that means "the input was wrong": its text is a sentence for the user."""


class UserError(ValueError):
    """Wrong input. The message says what was wrong, where, and what would be right.

    The command lines print the message and exit with code 2; a library user sees a ValueError.
    """
