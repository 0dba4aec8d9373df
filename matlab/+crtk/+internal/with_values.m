function request = with_values(what, device, name, values)
%WITH_VALUES  A request with arrays as arguments.

    request = struct('do', what, 'device', device, 'name', name);
    request.arguments = cellfun(@(value) crtk.internal.encode(value, name), values, ...
        'UniformOutput', false);
end
