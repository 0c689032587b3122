"""The proof: blind trials on concealed effects, sealed before they are diagnosed, scored after."""
