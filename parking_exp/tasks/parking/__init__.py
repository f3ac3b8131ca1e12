"""Parking, on highway-env's lot and on others: in highway-env and in a vectorized simulator.

The task: `parking_task`, `parking_config`, `parking_metrics`, `driven_path`, `reward`, `features`,
`pose`.

Lots and scenes: `lot_config` (the section of the config), `lot` (parametric lots), `highway_lot`
(highway-env's own, in NumPy), `stored_lot` (the lot of a stored run), `scenes`, `geometry`.

In NumPy: `simulator/`, `vec_env`.

In highway-env: `highway` makes the envs, and `lot_env` is the env of parametric lots. `obstacles`,
`nearby_vehicles` and `rays` have Gymnasium wrappers, some with the base `sensor_wrapper`.

Planning: `planning/`, `free_space`.

For people: `parking_report`, `lot_figures`, `episode_recording`, `replay_page`, `scene_shapes`,
`highway_video`.
"""
