"""Calibration of cameras: arrays in, estimates with covariances out.

Where a camera sits and how late its clock is, from tags that it saw on a drive along a known path:

    from slamsim.perception.calibration.mount import fit_mount
    from slamsim.perception.calibration.sightings import gather

    views = gather(stamps_ns, sightings, model)  # of ``TagDetector``, with the stamps of images
    found = fit_mount(views, model, trajectory, T_base_camera)  # as it is claimed
    found.T_base_camera, found.value("late_s"), found.sigma("late_s"), found.moved_from(T_claimed)

``trajectory`` is T_map_base by SLAM. The lens of a camera, and where those of a rig are to each
other, from pictures of a board: ``lens.fit_lens``.
"""
