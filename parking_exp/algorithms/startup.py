"""A short way from the start of a process to the first env step."""


def spare_dynamo() -> None:
    """Keep torch from importing its compiler, which takes a second, because an optimizer is made.

    Some methods of optimizers are never to be compiled, and torch finds the compiler's word for that at their first
    call. Here the word is given beforehand: the plain function. Where torch does it otherwise, nothing changes.
    """
    from torch.optim import Optimizer

    for name in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
        plain = getattr(getattr(Optimizer, name), "__wrapped__", None)
        if plain is not None and not hasattr(plain, "__dynamo_disable"):
            setattr(plain, "__dynamo_disable", plain)
