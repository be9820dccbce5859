"""What a case uses, needs, costs and risks, before it is run."""
