"""The schema of a run's config, composing it from conf/, and checking it; nothing here imports
torch.
"""
