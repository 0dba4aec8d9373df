function value = query(device, name, varargin)
%QUERY  The answer of a kinematics service.

    request = crtk.internal.with_values('solve', device, name, varargin);
    value = crtk.internal.decode(crtk.internal.call(request));
end
