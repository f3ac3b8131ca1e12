"""Files of models with members that Stable-Baselines3 did not write."""

import io
import zipfile


def rewritten(content, **members):
    """Return a zip file with other members, such as `policy_pth`, and checksums that are right.

    None leaves a member out.
    """
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            member = members.get(name.replace(".", "_"), old.read(name))
            if member is not None:
                new.writestr(name, member)
    return file.getvalue()
